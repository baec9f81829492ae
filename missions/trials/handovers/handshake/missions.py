"""Whole missions of level ``sim`` for the handshake: how long agreement took, by the paper's
definition.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from missions.ground import rig_library
from missions.look.report.records import RunRecords, judged_pairs, last
from missions.look.report.summary import summarize
from missions.trials.shared import flown
from path.config import GateKind
from path.values import frozen

RIG = "sim"
Errors = Mapping[str, Any] | None
# The faults of 45 attempts, in this order again and again; wind, look-alikes and biases are as
# ever.
FAULTS: tuple[tuple[str, ...], ...] = (
    (), ("link_loss=0.05",), (), ("lookalike",), (), ("link_delay=0.02",), (), ("link_loss=0.2",), (),
    (), ("lookalike",), (), ("link_loss=0.1",), (), ("link_delay=0.05",), (), ("marker_hidden",), (),
)  # fmt: skip


@frozen
class FlownMission:
    """The result of a mission.

    Attributes:
        seconds: from the first pair whose overlap exceeds the threshold to the commit; None without
            a commit.
        ended: outcome and detail of the run.
        wrong: whether another object than the target was handed over.
    """

    gate: GateKind
    faults: tuple[str, ...]
    seconds: float | None
    wrong: bool
    ended: str
    violations: int


Flown = Sequence[FlownMission]


def of_gate(flown: Flown, gate: GateKind) -> list[FlownMission]:
    """Return the missions of one gate."""
    return [each for each in flown if each.gate == gate]


def seconds_of(flown: Flown) -> list[float]:
    """Return the times to the commit, of the missions that committed."""
    return [each.seconds for each in flown if each.seconds is not None]


def orders(
    count: int, seed: int, gate: GateKind, out: Path, errors: Errors = None
) -> list[partial[FlownMission]]:
    """Return so many missions: the same seeds and faults for every gate. ``errors``: of their
    world; None as the rig says.
    """
    return [
        partial(
            fly, seed * 1000 + k, FAULTS[k % len(FAULTS)], gate, out / f"{gate}-{k:03d}", errors
        )
        for k in range(count)
    ]


def fly(
    seed: int, faults: tuple[str, ...], gate: GateKind, folder: Path, errors: Errors = None
) -> FlownMission:
    """Fly one mission; its logs are read and thrown away."""
    rig = rig_library.load(RIG)
    if errors is not None:
        rig = replace(rig, world={**rig.world, "errors": errors})
    rig = replace(rig, method=replace(rig.method, gate=gate))
    facts, run = flown.fly_and_throw_away(rig, seed, faults, folder)
    return FlownMission(
        gate=gate,
        faults=faults,
        seconds=agreement_s(run),
        wrong=bool(summarize(run)["wrong_handover"]),
        ended=f"{facts.outcome}: {facts.detail}",
        violations=sum(facts.violations.values()),
    )


def agreement_s(run: RunRecords) -> float | None:
    """The paper's time to hand-off: from the first frame whose IoU exceeds the threshold to the
    commit, s.

    None without a commit. Resets of the count in between are part of it.
    """
    commit = last(run.sender, "/commit")
    agreed = [
        record.record["capture_ns"] for record in judged_pairs(run) if record.record["agreed"]
    ]
    return (commit.stamp_ns - agreed[0]) * 1e-9 if commit is not None and agreed else None
