"""Two real role processes on a bad link, killed at every step, flooded by a third: who was
responsible, and when.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

from missions.ground.run_folder import new_folder
from missions.look.report.tables import counts_text, sum_of
from missions.trials.cost.processes import runs
from missions.trials.cost.processes.runs import LIVE, SIM, Came
from missions.trials.shared.trial import (
    TrialFinding,
    TrialRequest,
    TrialResult,
    TrialTable,
    verdict,
)
from path.protocol.values import ProtocolConfig

TITLE = "Processes: the hand-over on bad links, killed at every step, and under attack"
PAPER = "not in the paper: the hand-over protocol"

LIVE_SEEDS = (1, 2)
QUICK_SEEDS = (1,)
SIM_PHASES_S = (0.0, 0.7, 2.0)
SIM_RESTARTS_S = (None, 0.05, 0.5, 3.0)
LIVE_PHASES_S = (0.2,)
LIVE_RESTARTS_S = (None, 0.5)
QUICK_KILLS = 4

Runs = Sequence[Came]


def bound_s(config: ProtocolConfig | None = None) -> float:
    """L2: nobody is responsible for longer than lease, clock uncertainty, and the lateness of a
    program.
    """
    config = config or ProtocolConfig()
    return config.lease_s + config.max_uncertainty_s + config.guard_s


def run(request: TrialRequest) -> TrialResult:
    out = request.out / "runs"
    base = request.seed * 100
    seeds = [base + seed for seed in (QUICK_SEEDS if request.quick else LIVE_SEEDS)]
    live_rig = runs.signed_rig(LIVE, new_folder(out))
    simulated = runs.kills(SIM, seeds[:1], SIM_PHASES_S, SIM_RESTARTS_S, out / SIM)
    live = runs.kills(live_rig, seeds[:1], LIVE_PHASES_S, LIVE_RESTARTS_S, out / LIVE)
    links = runs.links(live_rig, seeds, out / LIVE)
    attacks = runs.attacks(live_rig, seeds, out / LIVE)
    if request.quick:
        simulated = simulated[-QUICK_KILLS:]
        live = []
        links = []
        attacks = []
    in_sim = request.work.map("kills in virtual time", runs.fly, simulated)
    at_once = [runs.fly(one) for one in request.work.steps("kills of real processes", live)]
    linked = [
        runs.fly(one) for one in request.work.steps("bad links between real processes", links)
    ]
    attacked = [runs.fly(one) for one in request.work.steps("attacks by a third process", attacks)]
    return TrialResult(
        summary={
            "bound_s": bound_s(),
            "kills_sim": _figures(in_sim),
            "kills_sitl": _figures(at_once),
            "links": _figures(linked),
            "attacks": _figures(attacked),
        },
        findings=(
            *_findings("kills in virtual time", in_sim),
            *_findings("kill -9 of real processes", at_once),
            *_findings("bad links", linked),
            *_findings("attacks", attacked),
        ),
        noise=None,
        tables=(
            *_link_tables("Bad links, real processes in real time", linked),
            *_link_tables("Attacks by a third process", attacked),
            *_kill_tables("kill -9 of a real process, in real time", at_once),
            *_kill_tables("A program killed in virtual time", in_sim),
        ),
        notes=(
            "Recomputed from the logs of both roles' programs on one clock; no role's own count is believed. A program "
            "that died is responsible for nothing until it is started again.",
            f"The bound is lease + clock uncertainty + guard = {bound_s():.2f} s. Excused is only the time in which "
            "the program does not run whose turn it is: the sender's until it has handed over, then the receiver's.",
            "Orphaned: the receiver's ACCEPT was written down and its CONFIRM did not come within the lease; nobody is "
            "responsible, and somebody said so.",
            f"Live runs fly {LIVE}, a short course with small pictures; a busy machine delays them, and then some runs "
            "end in an outcome of the mission (a camera that is late, a peer that is not heard).",
        ),
    )


def _figures(came: Runs) -> dict[str, Any]:
    return {
        "runs": len(came),
        "outcomes": dict(Counter(one.outcome for one in came)),
        "two_responsible_s": max((one.duty.both_s for one in came), default=0.0),
        "longest_gap_s": max(
            (one.duty.gap_s for one in came if not one.duty.orphaned), default=0.0
        ),
        "orphaned": sum(one.duty.orphaned for one in came),
        "not_landed": sum(not one.landed for one in came),
        "wrong": sum(one.wrong for one in came),
        "violations": dict(sum_of(one.violations for one in came)),
        "each": [_row(one) for one in came],
    }


def _row(came: Came) -> dict[str, Any]:
    asked = came.asked
    duty = came.duty
    return {
        "faults": list(asked.faults), "rig": asked.rig, "seed": asked.seed, "outcome": came.outcome,
        "detail": came.detail, "roles": came.outcomes, "both_s": duty.both_s, "gap_s": duty.gap_s,
        "dead_s": duty.dead_s, "orphaned": duty.orphaned, "holder": duty.holder.value if duty.holder else None,
        "decision_s": duty.commit_s, "agreement_s": came.agreement_s, "landed": came.landed,
        "violations": came.violations, "dropped": came.dropped, "wall_s": round(came.wall_s, 1),
    }  # fmt: skip


def _findings(what: str, came: Runs) -> tuple[TrialFinding, ...]:
    if not came:
        return ()
    two = max(one.duty.both_s for one in came)
    gap = max((one.duty.gap_s for one in came if not one.duty.orphaned), default=0.0)
    down = sum(one.landed for one in came)
    broken = sum_of(one.violations for one in came)
    count = f"{len(came)} runs"
    none_two = verdict(two == 0.0)
    return (
        TrialFinding(f"{what}: longest time with two responsible, s", f"{two:.3f}", count, goal="0", verdict=none_two),
        TrialFinding(
            f"{what}: longest time with none that no dead program excuses, s", f"{gap:.2f}", count,
            goal=f"≤ {bound_s():.2f}", verdict=verdict(gap <= bound_s()),
        ),
        TrialFinding(
            f"{what}: monitors violated", ", ".join(sorted(broken)) or "none", count, goal="none",
            verdict=verdict(not broken),
        ),
        TrialFinding(
            f"{what}: both vehicles on the ground in the end", f"{down} of {len(came)}", goal="all",
            verdict=verdict(down == len(came)),
        ),
    )  # fmt: skip


def _seconds(values: Sequence[float | None]) -> str:
    known = sorted(value for value in values if value is not None)
    if not known:
        return "-"
    return f"{known[0]:.1f}" if len(known) == 1 else f"{known[0]:.1f} to {known[-1]:.1f}"


def _counted(names: Sequence[str]) -> str:
    return ", ".join(
        name + (f" ×{count}" if count > 1 else "") for name, count in Counter(names).items()
    )


def _link_tables(title: str, came: Runs) -> tuple[TrialTable, ...]:
    if not came:
        return ()
    names = dict.fromkeys(one.asked.what for one in came)
    groups = {what: [one for one in came if one.asked.what == what] for what in names}
    rows = [
        (
            what, _counted([one.outcome for one in own]), _seconds([one.agreement_s for one in own]),
            f"{max(one.duty.gap_s for one in own):.3f}", f"{max(one.duty.both_s for one in own):.0f}",
            _dropped(own),
        )
        for what, own in groups.items()
    ]  # fmt: skip
    columns = (
        "link",
        "outcome",
        "agreement took, s",
        "nobody, at most, s",
        "two, s",
        "packets dropped by the ends",
    )
    return (TrialTable(title, columns, tuple(rows)),)


def _dropped(came: Runs) -> str:
    dropped = sum_of(reasons for one in came for reasons in one.dropped.values())
    return counts_text(dict(dropped.most_common()))


def _kill_tables(title: str, came: Runs) -> tuple[TrialTable, ...]:
    if not came:
        return ()
    rows: list[tuple[str, ...]] = []
    for one in came:
        asked = one.asked
        duty = one.duty
        rows.append((
            asked.what, "never" if asked.restart_s is None else f"{asked.restart_s:g} s later", one.outcomes["sender"],
            one.outcomes["receiver"], f"{duty.both_s:.0f}", f"{duty.gap_s:.2f}", f"{duty.dead_s:.1f}",
            "orphaned" if duty.orphaned else duty.holder.value if duty.holder else "nobody: its program is dead",
            "yes" if one.landed else "NO",
        ))  # fmt: skip
    columns = (
        "killed", "started again", "sender", "receiver", "two, s", "nobody, s", "nobody, its program dead, s",
        "responsible in the end", "both down",
    )  # fmt: skip
    return (TrialTable(title, columns, tuple(rows)),)
