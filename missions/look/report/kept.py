"""Whether D2 keeps the target that it took over: its boxes of the ten seconds after that, against
the truth.
"""

from __future__ import annotations

from drivers.log.mcap_log import LogRecord
from flight.outcome import KEPT_S
from missions.look.report.records import RunRecords
from missions.look.report.truth import Truth, box_center
from path.messages import Role
from path.values import frozen

LAST_S = 2.0  # the end of what is looked at: without a box of the target in it, the target is lost


@frozen
class Kept:
    """What came of the target after the hand-over.

    Attributes:
        seconds: from taking over to the last box of the target.
        lost: within ``KEPT_S``, or it was another object that was followed at the end.
    """

    seconds: float
    lost: bool


def kept_of(run: RunRecords, truth: Truth | None) -> Kept | None:
    """None where D2 never took the target over. Without truth whatever it follows is taken for the
    target.
    """
    phases = run.receiver.get("/phase", ())
    taken_ns = next((each.stamp_ns for each in phases if each.record["phase"] == "follow"), None)
    if taken_ns is None:
        return None
    end_ns = next(
        (each.stamp_ns for each in phases if each.stamp_ns > taken_ns),
        taken_ns + round(KEPT_S * 1e9),
    )
    end_ns = min(end_ns, taken_ns + round(KEPT_S * 1e9))
    boxes = [
        each
        for each in run.receiver.get("/track", ())
        if taken_ns <= each.stamp_ns <= end_ns and each.record["box"] is not None
    ]
    own_ns = [each.stamp_ns for each in boxes if truth is None or _is_target(each, truth)]
    if not own_ns:
        return Kept(0.0, lost=True)
    lost = (end_ns - own_ns[-1]) * 1e-9 > LAST_S
    return Kept((own_ns[-1] - taken_ns) * 1e-9, lost)


def _is_target(seen: LogRecord, truth: Truth) -> bool:
    return (
        truth.object_at(Role.RECEIVER, seen.stamp_ns, box_center(seen.record["box"]))
        == truth.scene.target_id
    )
