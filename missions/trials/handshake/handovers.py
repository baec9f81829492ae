"""Monte-Carlo hand-overs by the thousand, each judged by both gates on the same stream of pairs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, get_args

import numpy as np

from drivers.clock import busy_ns
from flight.harness.montecarlo import Attempt, FaultName, HandoverRunner, MonteCarloHandover, Series, agreeing, tell
from missions import rig_library
from missions.rig_library import trial_part
from path.config import GateKind, MethodConfig
from path.gate.evidence import make_gate

GATES: tuple[GateKind, GateKind] = get_args(GateKind)
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
        reason: why the paper's gate did not commit; empty when it did.
        judged: by both gates, in the order of ``GATES``.
        closest_m: how near a look-alike came to the target.
    """

    index: int
    fault: FaultName
    reason: str
    judged: tuple[GateVerdict, GateVerdict]
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
    tried: list[HandshakeAttempt] = []
    start_ns, simulated_s = busy_ns(), 0.0
    for index in asked.indices:
        attempt = attempt_of(asked.seed, index)
        found = runner.run(attempt)
        evidence = by_evidence(found.series, method)
        simulated_s += found.simulated_s
        if not evidence.committed and found.simulated_s < attempt.limit_s:
            # all is said by the paper's gate, but not by the other one: go on
            more = runner.run(replace(attempt, whole=True))
            simulated_s += more.simulated_s
            evidence = by_evidence(more.series, method)
        judged = by_count(found), evidence
        tried.append(HandshakeAttempt(index, attempt.fault, found.reason, judged, found.circumstances.closest_m))
    return BatchResult(tuple(tried), simulated_s, (busy_ns() - start_ns) * 1e-9)


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


def wrong_by_fault(tried: Sequence[HandshakeAttempt]) -> dict[GateKind, dict[str, int]]:
    """Wrong hand-overs of each gate by the attempt's fault."""
    found: dict[GateKind, dict[str, int]] = {}
    for k, gate in enumerate(GATES):
        wrong = [each.fault for each in tried if each.judged[k].committed and not each.judged[k].right]
        found[gate] = dict(Counter(wrong).most_common())
    return found
