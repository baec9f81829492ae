"""Lateness in a run in real time: what a computer that was too slow is blamed for, and nobody
else.
"""

from __future__ import annotations

from flight.harness.flights import Report
from flight.outcome import OBJECT_MONITOR, Outcome

OF_TIME = frozenset(Outcome) - {
    Outcome.COMMITTED, Outcome.FLOWN, Outcome.PILOT_OVERRIDE, Outcome.ORPHANED, Outcome.STATE_LOST, Outcome.UNFIT,
    Outcome.INTERRUPTED, Outcome.CRASHED, Outcome.RESTARTED, Outcome.LOG_FAILED,
    Outcome.NOT_STARTED,
}  # fmt: skip
MONITORS_OF_TIME = frozenset({"S7", OBJECT_MONITOR, "L1", "L2"})
"""Ends that a computer that does not keep up can be the cause of: they say nothing of the mission.

S8 is none of them: a gap between setpoints has a time of its own, and so has what explains it.
"""


def for_lateness(
    report: Report,
    outcome: Outcome,
    detail: str,
) -> tuple[Outcome, str]:
    """The outcome of a run: ``overloaded`` where lateness can be the cause, and what it would have
    been.
    """
    overload = report.overload
    others = set(report.violations) - MONITORS_OF_TIME - set(report.explained)
    if overload and outcome in OF_TIME and not others:
        return Outcome.OVERLOADED, f"{overload} (and so {outcome.label}: {detail})"
    return outcome, detail
