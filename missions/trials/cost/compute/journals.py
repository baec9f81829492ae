"""The records that both roles write in a cycle: made, encoded and written as in flight, from the
same functions.
"""

from __future__ import annotations

from collections.abc import Sequence

from drivers.interfaces import Log, View
from flight.frame.records import (
    Answer,
    OwnFrame,
    candidate_record,
    heard_candidate_record,
    heard_target_record,
    marker_record,
    motion_record,
    target_record,
)
from flight.frame.sender import SenderSide
from flight.rendezvous.marker_view import MarkerFix, VehicleMotions
from missions.ground.journal import frame_record
from path.cycle.sender import PairVerdict
from path.geometry.transforms import Matrix
from path.messages import Candidate, Target


def log_sender(
    log: Log,
    view: View,
    own: OwnFrame,
    heard: Candidate,
    pairs: Sequence[PairVerdict],
    side: SenderSide,
) -> None:
    """Write D1's frame, what it sent, what it heard, and what that was worth."""
    stamp_ns = view.stamp_ns
    log.write("/frame", stamp_ns, frame_record(view, stamp_ns))
    log.write("/target", stamp_ns, target_record(own, stamp_ns))
    log.write("/heard_candidate", stamp_ns, heard_candidate_record(heard, heard.capture_ns))
    for pair in pairs:
        log.write("/agreement", stamp_ns, side.record(pair))


def log_receiver(
    log: Log,
    view: View,
    heard: Target,
    fix: MarkerFix,
    motion: VehicleMotions,
    attitudes: tuple[Matrix, Matrix | None],
    answer: Answer,
) -> None:
    """Write D2's frame, what it heard, the marker, and its answer. ``attitudes`` are ``R_n_c`` and
    ``R_n_v``.
    """
    stamp_ns = view.stamp_ns
    log.write("/frame", stamp_ns, frame_record(view, stamp_ns))
    log.write("/heard_target", stamp_ns, heard_target_record(heard, heard.capture_ns))
    log.write("/marker", stamp_ns, marker_record(stamp_ns, fix))
    log.write("/motion", stamp_ns, motion_record(motion, *attitudes, fix))
    log.write("/candidate", stamp_ns, candidate_record(answer))
