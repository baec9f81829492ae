"""Lateness in a run in real time: what a computer that was too slow is blamed for, and nobody else."""

from __future__ import annotations

from collections.abc import Collection

from flight.outcome import OBJECT_MONITOR, Outcome

OF_TIME = frozenset(Outcome) - {
    Outcome.COMMITTED, Outcome.FLOWN, Outcome.PILOT_OVERRIDE, Outcome.ORPHANED, Outcome.STATE_LOST, Outcome.UNFIT,
    Outcome.INTERRUPTED, Outcome.CRASHED, Outcome.RESTARTED, Outcome.LOG_FAILED,
}  # fmt: skip
MONITORS_OF_TIME = frozenset({"S7", "S8", OBJECT_MONITOR, "L1", "L2"})
"""Ends that a computer that does not keep up can be the cause of: they say nothing of the mission."""


def for_lateness(overload: str, violations: Collection[str], outcome: Outcome, detail: str) -> tuple[Outcome, str]:
    """The outcome of a run: ``overloaded`` where lateness can be the cause, and what it would have been.

    Args:
        overload: what was late, and how late; empty when the computer kept up.
        violations: the monitors that were violated.
    """
    if overload and outcome in OF_TIME and not set(violations) - MONITORS_OF_TIME:
        return Outcome.OVERLOADED, f"{overload} (and so {outcome.label}: {detail})"
    return outcome, detail
