"""Hand-overs with faults, by the thousand: each until the default gate has decided, every second
until both have.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import get_args

from drivers.clock import busy_ns
from flight.harness.montecarlo import Attempt, FaultName, HandoverRunner, Telling
from missions.trials.handovers.judging import GATES, JudgedAttempt, verdict_of
from path.config import GateKind, MethodConfig
from path.gate.evidence import make_gate
from path.values import frozen

FAULT_NAMES: tuple[FaultName, ...] = get_args(FaultName)
LIMIT_S = 12.0


@frozen
class HandshakeAttempt(JudgedAttempt):
    """One attempt with a fault.

    Attributes:
        reason: why the paper's gate did not commit; empty when it did, or was not run to its end.
        closest_m: how near a look-alike came to the target.
        simulated_s, busy_s: how much was run, and what its core spent on it.
    """

    fault: FaultName
    reason: str
    closest_m: float
    simulated_s: float
    busy_s: float


Tried = Sequence[HandshakeAttempt]


def attempt_of(seed: int, index: int) -> Attempt:
    """Return an attempt; every kind of fault comes equally often."""
    return Attempt(seed, index, FAULT_NAMES[index % len(FAULT_NAMES)], limit_s=LIMIT_S)


def is_counted(index: int) -> bool:
    """Return whether an attempt is run to the end of the paper's gate too: every second round of
    all faults.

    That gate takes 7 s at the least where the other takes 1.7 s, which is most of what an attempt
    costs.
    """
    return index // len(FAULT_NAMES) % 2 == 0


def judge(
    runner: HandoverRunner,
    method: MethodConfig,
    attempt: Attempt,
) -> HandshakeAttempt:
    """Run one attempt until the default gate has committed, and where it is counted until the
    paper's has decided.
    """
    begin_ns = busy_ns()
    counted = is_counted(attempt.index)
    own = replace(method, gate="evidence")
    telling = Telling(make_gate(own), own)
    found = runner.run(
        replace(attempt, whole=not counted), lambda series: telling.on(series) is not None
    )
    return HandshakeAttempt(
        index=attempt.index,
        count=verdict_of(found.series, method, "count") if counted else None,
        evidence=verdict_of(found.series, method, "evidence"),
        fault=attempt.fault,
        reason=found.reason if counted else "",
        closest_m=found.circumstances.closest_m,
        simulated_s=found.simulated_s,
        busy_s=(busy_ns() - begin_ns) * 1e-9,
    )


def reasons(tried: Tried) -> dict[str, int]:
    """Count the timeouts of the paper's gate by what was missed most often."""
    return dict(Counter(each.reason for each in tried if each.reason).most_common())


def wrong_by_fault(tried: Tried) -> dict[GateKind, dict[str, int]]:
    """Count the wrong hand-overs of each gate by the attempt's fault."""
    found: dict[GateKind, dict[str, int]] = {}
    for gate in GATES:
        judged = ((each.fault, each.by(gate)) for each in tried)
        wrong = Counter(fault for fault, verdict in judged if verdict is not None and verdict.wrong)
        found[gate] = dict(wrong.most_common())
    return found
