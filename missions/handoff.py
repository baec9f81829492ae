"""``path-handoff handoff``: both roles and their world from one terminal, the run folder, and many runs by seed."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

from drivers.interfaces import PartError
from drivers.rig import Rig, import_factory
from flight.harness import Emit, FlightReport, FlightRequest, Harness, RoleResult
from flight.outcome import Outcome
from missions.records import RunFacts, write_facts
from missions.role_process import fly_role
from path.messages import Role

_CONSEQUENCES = frozenset({Outcome.PEER_LOST, Outcome.PEER_ABORTED})


def new_folder(out: Path | None) -> Path:
    """The folder of a run, made; ``runs/<time>`` by default. Raises PartError."""
    folder = out or Path("runs") / datetime.now().strftime("%Y%m%d-%H%M%S")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise PartError(f"cannot make {folder}: {error.strerror}", "name another folder with --out") from error
    return folder


def harness_of(rig: Rig) -> Harness:
    """The harness a rig names. Raises PartError when it names none: then each role is started on its own drone."""
    if rig.harness is None:
        raise PartError(
            f"rig {rig.name} is flown from its drones: it has no harness",
            f"start `path-handoff sender --rig {rig.name}` on one and `path-handoff receiver --rig {rig.name}` on the other",
        )
    return import_factory(rig.harness, rig.where("harness"))()


def fly_once(rig: Rig, seed: int, faults: Sequence[str], out: Path, emit: Emit) -> RunFacts:
    """One run to its end; writes logs and ``run.json`` into ``out``. Raises PartError for what was asked wrongly."""
    harness = harness_of(rig)

    def command(role: Role) -> Sequence[str]:
        return [
            sys.executable, "-m", "missions.cli", role.value, "--rig", str(rig.file), "--out", str(out),
            "--console", "events",
        ]  # fmt: skip

    report = harness.fly(FlightRequest(rig, out, seed, tuple(faults), fly_role, command, emit))
    outcome, detail = judge(report)
    facts = RunFacts(
        rig=rig.name,
        level=rig.level,
        seed=seed,
        outcome=outcome.label,
        exit_code=outcome.exit_code,
        detail=detail,
        faults=tuple(faults),
        simulated_s=round(report.simulated_s, 3),
        wall_s=report.wall_s,
        violations=dict(report.violations),
        notes=tuple(report.notes),
    )
    write_facts(out, facts)
    return facts


def judge(report: FlightReport) -> tuple[Outcome, str]:
    """The outcome of the whole run: the harness's own failure and violated monitors first, then the roles' causes."""
    if report.failure:
        return Outcome.HARNESS_FAILED, report.failure
    if report.violations:
        return Outcome.MONITOR_VIOLATED, "; ".join(report.notes)
    if report.interrupted:
        return Outcome.INTERRUPTED, Outcome.INTERRUPTED.meaning
    results = [_dead(role) if result is None else result for role, result in report.results.items()]
    ends = [result for result in results if result.outcome is not Outcome.COMMITTED]
    if not ends:
        if all(report.landed.values()):
            return Outcome.COMMITTED, ""
        return Outcome.VEHICLE_REFUSED, "a vehicle did not land"
    # what one drone did because of the other is not the cause
    causes = [end for end in ends if end.outcome not in _CONSEQUENCES] or ends
    cause = causes[0]
    return cause.outcome, f"{cause.role.value}: {cause.detail}"


def _dead(role: Role) -> RoleResult:
    return RoleResult(role, Outcome.CRASHED, "its program died", responsible=False, landed=False)
