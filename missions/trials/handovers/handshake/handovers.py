"""Monte-Carlo hand-overs by the thousand: each until the default gate has decided, every second until both have.

Both gates are told the same stream of pairs.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, get_args

import numpy as np

from drivers.clock import busy_ns
from drivers.collector import collector_off
from flight.harness.montecarlo import (
    Attempt,
    FaultName,
    HandoverRunner,
    MonteCarloHandover,
    Series,
    Telling,
    agreeing,
    tell,
)
from missions import rig_library
from missions.rig_library import trial_part
from path.config import GateKind, MethodConfig
from path.gate.evidence import make_gate

# The trial is about these two, the paper's and the default. Other kinds of gate are not flown here.
GATES: tuple[GateKind, GateKind] = ("count", "evidence")
FAULT_NAMES: tuple[FaultName, ...] = get_args(FaultName)
CHUNK = 70
LIMIT_S = 12.0


@dataclass(frozen=True, slots=True)
class GateVerdict:
    """The result of one gate on an attempt.

    Attributes:
        seconds: from the first agreeing pair to the commit.
        right: whether D2's box was of the target.
        same: whether it was of the object that D1's box was of: D1 may have lost the target to a look-alike itself.
    """

    committed: bool
    seconds: float
    right: bool
    same: bool


NOT_COMMITTED = GateVerdict(committed=False, seconds=0.0, right=False, same=False)


@dataclass(frozen=True, slots=True)
class HandshakeAttempt:
    """One attempt.

    Attributes:
        reason: why the paper's gate did not commit; empty when it did, or was not run to its end.
        judged: by both gates, in the order of ``GATES``; None of the paper's where it was not run to that gate's end.
        closest_m: how near a look-alike came to the target.
    """

    index: int
    fault: FaultName
    reason: str
    judged: tuple[GateVerdict | None, GateVerdict]
    closest_m: float


@dataclass(frozen=True, slots=True)
class BatchResult:
    """Attempts run by one process. ``busy_s``: what its core spent on them."""

    tried: tuple[HandshakeAttempt, ...]
    simulated_s: float
    busy_s: float


@dataclass(frozen=True, slots=True)
class AttemptBatch:
    """``indices`` of the attempts to run."""

    rig: str
    seed: int
    indices: tuple[int, ...]


def asked_for(rig: str, seed: int, attempts: int) -> list[AttemptBatch]:
    return [
        AttemptBatch(rig, seed, tuple(range(at, min(at + CHUNK, attempts)))) for at in range(0, attempts, CHUNK)
    ]  # fmt: skip


@cache
def runner_of(rig_name: str) -> HandoverRunner:
    """One for each process: kernels are loaded once."""
    rig = rig_library.load(rig_name)
    kind: Any = trial_part(rig, "montecarlo")
    runner: HandoverRunner = kind(rig)
    return runner.warmed()


def attempt_of(seed: int, index: int) -> Attempt:
    """Every kind of fault equally often."""
    return Attempt(seed, index, FAULT_NAMES[index % len(FAULT_NAMES)], limit_s=LIMIT_S)


def run_chunk(asked: AttemptBatch) -> BatchResult:
    runner, method = runner_of(asked.rig), rig_library.load(asked.rig).method
    start_ns = busy_ns()
    with collector_off():  # attempts leave next to no garbage
        ran = [run_one(runner, method, asked.seed, index) for index in asked.indices]
    return BatchResult(tuple(t for t, _ in ran), sum(s for _, s in ran), (busy_ns() - start_ns) * 1e-9)


def run_one(runner: HandoverRunner, method: MethodConfig, seed: int, index: int) -> tuple[HandshakeAttempt, float]:
    """One attempt, and how much time was run: until the gate "evidence" has committed, and the paper's has decided."""
    attempt, counted = attempt_of(seed, index), is_counted(index)
    own = replace(method, gate="evidence")
    telling = Telling(make_gate(own), own)
    found = runner.run(replace(attempt, whole=not counted), lambda series: telling.on(series) is not None)
    judged = by_count(found) if counted else None, by_evidence(found.series, method)
    reason = found.reason if counted else ""
    return HandshakeAttempt(index, attempt.fault, reason, judged, found.circumstances.closest_m), found.simulated_s


def is_counted(index: int) -> bool:
    """Returns whether an attempt is run to the end of the paper's gate too: every second round of all faults.

    That gate takes 7 s at the least where the other takes 1.7 s, which is most of what an attempt costs.
    """
    return index // len(FAULT_NAMES) % 2 == 0


def by_count(found: MonteCarloHandover) -> GateVerdict:
    """The paper's gate has judged it already."""
    if found.start_s is None or found.commit_s is None:
        return NOT_COMMITTED
    seconds = found.commit_s - found.start_s
    return GateVerdict(committed=True, seconds=seconds, right=found.right is True, same=found.same is True)


def by_evidence(series: Series, method: MethodConfig) -> GateVerdict:
    """The other gate on the same stream."""
    own = replace(method, gate="evidence")
    done = tell(series, make_gate(own), own)
    if done is None:
        return NOT_COMMITTED
    start = int(np.argmax(agreeing(series, own)))
    seconds = (int(series.now_ns[done]) - int(series.capture_ns[start])) * 1e-9
    return GateVerdict(committed=True, seconds=seconds, right=bool(series.right[done]), same=bool(series.same[done]))


def reasons(tried: Sequence[HandshakeAttempt]) -> dict[str, int]:
    """Timeouts of the paper's gate by what was missed most often."""
    return dict(Counter(each.reason for each in tried if each.reason).most_common())


def judged_by(tried: Sequence[HandshakeAttempt], gate: GateKind) -> list[GateVerdict]:
    """The verdicts of a gate, on the attempts that were run to its end."""
    found = [each.judged[GATES.index(gate)] for each in tried]
    return [verdict for verdict in found if verdict is not None]


def wrong_by_fault(tried: Sequence[HandshakeAttempt]) -> dict[GateKind, dict[str, int]]:
    """Wrong hand-overs of each gate by the attempt's fault."""
    found: dict[GateKind, dict[str, int]] = {}
    for k, gate in enumerate(GATES):
        judged = [(each.fault, each.judged[k]) for each in tried]
        wrong = [fault for fault, verdict in judged if verdict is not None and verdict.committed and not verdict.right]
        found[gate] = dict(Counter(wrong).most_common())
    return found
