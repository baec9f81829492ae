"""Whole missions of level ``sim`` for the handshake: how long agreement took, by the paper's definition."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from drivers.rig.parts import Rig
from missions import rig_library
from missions.handoff.flight import fly_once
from missions.report.records import RUN, RunRecords, judged_pairs, last, load_run
from missions.report.summary import summarize
from missions.run_folder import discard, new_folder
from path.config import GateKind

RIG = "sim"
# The faults of 45 attempts, in this order again and again; wind, look-alikes and biases are as ever.
FAULTS: tuple[tuple[str, ...], ...] = (
    (), ("link_loss=0.05",), (), ("lookalike",), (), ("link_delay=0.02",), (), ("link_loss=0.2",), (),
    (), ("lookalike",), (), ("link_loss=0.1",), (), ("link_delay=0.05",), (), ("marker_hidden",), (),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class MissionOrder:
    """One mission."""

    seed: int
    faults: tuple[str, ...]
    gate: GateKind
    folder: Path


@dataclass(frozen=True, slots=True)
class FlightResult:
    """The result of a mission.

    Attributes:
        seconds: from the first pair whose overlap exceeds the threshold to the commit; None without a commit.
        outcome, detail: of the run.
        wrong: whether another object than the target was handed over.
    """

    asked: MissionOrder
    committed: bool
    seconds: float | None
    wrong: bool
    outcome: str
    detail: str
    misses: int
    violations: int


def asked_for(count: int, seed: int, gate: GateKind, out: Path) -> list[MissionOrder]:
    return [
        MissionOrder(seed * 1000 + k, FAULTS[k % len(FAULTS)], gate, out / f"{gate}-{k:03d}") for k in range(count)
    ]  # fmt: skip


def fly(asked: MissionOrder) -> FlightResult:
    """One mission from take-off to landing; its logs are read and thrown away."""
    rig = _rig(asked.gate)
    folder = new_folder(asked.folder)
    try:
        facts = fly_once(rig, asked.seed, asked.faults, folder, lambda _: None)
        run = load_run(folder)
    finally:
        discard(folder, RUN)
    summary: dict[str, Any] = summarize(run)
    seconds = agreement_s(run)
    return FlightResult(
        asked=asked,
        committed=seconds is not None,
        seconds=seconds,
        wrong=bool(summary["wrong_handover"]),
        outcome=facts.outcome,
        detail=facts.detail,
        misses=sum(summary["misses"].values()),
        violations=sum(facts.violations.values()),
    )


def _rig(gate: GateKind) -> Rig:
    rig = rig_library.load(RIG)
    return replace(rig, method=replace(rig.method, gate=gate))


def agreement_s(run: RunRecords) -> float | None:
    """The paper's time to hand-off: from the first frame whose IoU exceeds the threshold to the commit, s.

    None without a commit. Resets of the count in between are part of it.
    """
    commit = last(run.sender, "/commit")
    agreed = [record.record["capture_ns"] for record in judged_pairs(run) if record.record["agreed"]]
    return (commit.stamp_ns - agreed[0]) * 1e-9 if commit is not None and agreed else None
