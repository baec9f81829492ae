"""A long verification in real time: does memory stay flat, does anything queue up, and what costs
how much.
"""

from __future__ import annotations

import io
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from drivers.interfaces import PartError
from drivers.log.mcap_log import LogRecord
from drivers.rig.parts import Rig, part_context
from drivers.rig.toml_text import toml_text
from flight.harness.flights import Progress
from flight.outcome import Outcome
from flight.phases import Phase
from missions.fly.handoff.flight import fly_once
from missions.ground import rig_library
from missions.ground.run_folder import new_folder
from missions.look.report.command import make_report
from missions.look.report.records import Records, RunRecords, load_run
from missions.trials.cost.soak.watch import PROC, ProgramSample, Watch
from missions.trials.shared.trial import (
    TrialFinding,
    TrialRequest,
    TrialResult,
    TrialTable,
    verdict,
)
from path.messages import Role

TITLE = "Soak: memory, processor and queues over a long verification in real time"
PAPER = ""

SECONDS = 1200.0
QUICK_SECONDS = 20.0
SAMPLE_S = 2.0
SETTLED = 0.25  # of the time: what is allocated once is allocated by then
FLAT_MIB = 5.0
# the overlap that is asked for: no two boxes are that alike, it verifies until its deadline
NEVER = 1.0
GOAL_MIB = 300.0
QUEUE_MS = 5.0
_QUANTILES = (("p50", 50), ("p95", 95))

Samples = Mapping[str, Sequence[ProgramSample]]
"""Of each program by its name, while both roles verified."""


def check(rig: Rig) -> None:
    """Raise PartError for a rig that does not fly in real time, and where there is no /proc."""
    if rig.level != "sitl" or not PROC.joinpath("self", "task").is_dir():
        command = "path-handoff trial cost --only soak --rig sitl"
        raise PartError("a soak wants a rig of level sitl, and Linux's /proc", command)


def run(request: TrialRequest) -> TrialResult:
    """Raise PartError where the flight ended before it should."""
    seconds = request.seconds or (QUICK_SECONDS if request.quick else SECONDS)
    rig = _endless(request.rig, seconds, request.out)
    samples, flown = _fly(rig, request, seconds)
    return TrialResult(
        summary={
            "seconds": seconds,
            "memory_mib": {name: max(one.private_mib for one in taken) for name, taken in samples.items()},
            "growth_mib": {name: growth_mib(taken) for name, taken in samples.items()},
            "cores": {name: cpu_share(taken) for name, taken in samples.items()},
            "frame_age_ms": {role.value: ages_ms(flown.role(role)) for role in Role},
        },
        findings=_findings(samples, flown, seconds),
        tables=(_memory_table(samples), _cpu_table(samples)),
        notes=(
            f"Rig {request.rig.name}, seed {request.seed}, {os.cpu_count()} cores. No number of agreeing frames is "
            f"enough, so that both drones verify for {seconds:.0f} s, at full rate; then they end by the deadline.",
            f"Growth is from {100 * SETTLED:.0f} % of the time on: the median of the last quarter of what is left less "
            "that of its first. Threads have the names that their libraries give them.",
        ),
    )  # fmt: skip


def _endless(
    rig: Rig,
    seconds: float,
    out: Path,
) -> Rig:
    """The rig, with a verification that ends by its deadline only, as a file that its programs can
    read.
    """
    table: dict[str, Any] = {
        "like": str(rig.file.resolve()),
        "method": {"tau_min": NEVER, "tau_max": NEVER, "gate": "count"},
        "mission": {"deadlines": {"verify_s": float(seconds)}},
    }
    if rig.world.get("sender_simulator") is None:
        table["world"] = {"autopilot": {"endurance_s": 10.0 * seconds + 3000.0}}
    file = out / "rig.toml"
    file.write_text(
        toml_text(table, f"{rig.name}, with a verification of {seconds:.0f} s"), "utf-8"
    )
    return rig_library.load(str(file))


def _fly(
    rig: Rig,
    request: TrialRequest,
    seconds: float,
) -> tuple[Samples, RunRecords]:
    """Samples of the programs while both verify, and the flight's logs. Raises PartError when they
    never did.
    """
    phases: dict[Role, str] = {}

    def note(progress: Progress) -> None:
        phases[progress.role] = progress.phase

    clock = part_context(rig, Role.SENDER).clock
    bar = iter(request.work.steps("samples", range(max(1, int(seconds / SAMPLE_S) - 1))))
    watch = Watch(
        period_s=SAMPLE_S,
        now_s=lambda: clock.now_ns() * 1e-9,
        wanted=lambda: all(phases.get(role) == Phase.VERIFY.title for role in Role),
        sampled=lambda: next(bar, None),
    )
    folder = new_folder(request.out / "flight")
    with watch:
        facts = fly_once(rig, request.seed, (), folder, note)
    make_report(folder, True, io.StringIO())
    if not watch.samples:
        raise PartError(
            f"the drones never verified: {facts.outcome}: {facts.detail}",
            f"see {folder}, or fly it alone: path-handoff handoff --rig {rig_library.name_of(request.rig)}",
        )
    return watch.samples, load_run(folder)


# --- what was measured


def growth_mib(taken: Sequence[ProgramSample]) -> float:
    """Return how much more memory a program holds at the end than once it had settled."""
    held = np.array([sample.private_mib for sample in taken])[int(SETTLED * len(taken)) :]
    quarter = max(1, len(held) // 4)
    return round(float(np.median(held[-quarter:]) - np.median(held[:quarter])), 2)


def cpu_share(taken: Sequence[ProgramSample]) -> dict[str, float]:
    """Cores that a program kept busy, by thread name."""
    first = taken[0]
    last = taken[-1]
    elapsed_s = max(last.time_s - first.time_s, 1e-9)
    return {
        name: round((spent - first.cpu_s.get(name, 0.0)) / elapsed_s, 4)
        for name, spent in sorted(last.cpu_s.items(), key=lambda item: -item[1])
    }


def ages_ms(records: Records) -> dict[str, float]:
    """Return the age of frames when their cycle began: over all, and in the first and the last
    quarter of the time.
    """
    ages = np.array([frame.record["age_ns"] * 1e-6 for frame in _verifying(records, "/frame")])
    if len(ages) < 4:
        return {}
    quarter = len(ages) // 4
    parts = {"": ages, "first_quarter_": ages[:quarter], "last_quarter_": ages[-quarter:]}
    return {
        f"{name}{q}": round(float(np.percentile(of, p)), 2)
        for name, of in parts.items()
        for q, p in _QUANTILES
    }


def _verifying(records: Records, topic: str) -> list[LogRecord]:
    """Records of the time from the begin of verifying to the next phase."""
    phases = records.get("/phase", ())
    begin = next(
        (k for k, phase in enumerate(phases) if phase.record["phase"] == Phase.VERIFY.title), None
    )
    if begin is None:
        return []
    from_ns = phases[begin].stamp_ns
    to_ns = phases[begin + 1].stamp_ns if begin + 1 < len(phases) else 1 << 62
    return [record for record in records.get(topic, ()) if from_ns <= record.stamp_ns < to_ns]


# --- how it is shown


def _findings(
    samples: Samples,
    run: RunRecords,
    seconds: float,
) -> Sequence[TrialFinding]:
    facts = run.facts
    assert facts is not None, "the flight came to its end"
    ended = facts.outcome == Outcome.NO_AGREEMENT.label
    findings = [
        TrialFinding(
            "ended", facts.outcome, "", "", f"by the deadline of {seconds:.0f} s", verdict(ended), facts.detail,
        ),
        TrialFinding(
            "monitors violated", str(sum(facts.violations.values())), "", "", "0", verdict(not facts.violations),
            "; ".join(facts.notes),
        ),
    ]  # fmt: skip
    for name, taken in samples.items():
        findings += _memory_findings(name, taken)
    for role in Role:
        findings += _age_findings(role, ages_ms(run.role(role)))
    return findings


def _memory_findings(name: str, taken: Sequence[ProgramSample]) -> Iterator[TrialFinding]:
    grown = growth_mib(taken)
    most = max(one.private_mib for one in taken)
    goal = f"<= {FLAT_MIB:.0f}"
    yield TrialFinding(
        f"memory grown, {name}, MiB",
        f"{grown:+.1f}",
        "",
        "",
        goal,
        verdict(grown <= FLAT_MIB),
    )
    if name in [role.value for role in Role]:
        yield TrialFinding(
            f"memory, {name}, MiB",
            f"{most:.0f}",
            "",
            "",
            f"<= {GOAL_MIB:.0f}",
            verdict(most <= GOAL_MIB),
        )


def _age_findings(role: Role, ages: Mapping[str, float]) -> Iterator[TrialFinding]:
    if ages:
        first = ages["first_quarter_p95"]
        last = ages["last_quarter_p95"]
        yield TrialFinding(
            f"age of frames at their cycle, {role.value}, ms: median, p95",
            f"{ages['p50']:.1f}, {ages['p95']:.1f}",
            goal=f"p95 of the end <= of the begin + {QUEUE_MS:.0f}",
            verdict=verdict(last - first <= QUEUE_MS),
            note=f"p95 {first:.1f} in the first quarter, {last:.1f} in the last",
        )


def _memory_table(samples: Samples) -> TrialTable:
    rows = tuple(
        (name, f"{taken[0].private_mib:.1f}", f"{max(one.private_mib for one in taken):.1f}",
         f"{taken[-1].private_mib:.1f}", f"{growth_mib(taken):+.2f}")
        for name, taken in samples.items()
    )  # fmt: skip
    return TrialTable(
        "Memory of their own, MiB",
        ("program", "begin", "highest", "end", "grown"),
        rows,
    )


def _cpu_table(samples: Samples) -> TrialTable:
    rows: list[tuple[str, str, str]] = []
    for name, taken in samples.items():
        shares = cpu_share(taken)
        threads = ", ".join(
            f"{thread} {100 * share:.1f}" for thread, share in shares.items() if share >= 0.001
        )
        rows.append((name, f"{100 * sum(shares.values()):.1f}", threads))
    return TrialTable("Processor, % of a core", ("program", "all", "by thread"), rows)
