"""The records that both roles write in a cycle: made, encoded and written as in flight, from the same functions."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from drivers.interfaces import Log, View
from flight.rendezvous.marker_view import MarkerFix, VehicleMotions
from missions.leg.journal import (
    agreement_record,
    beside_record,
    candidate_record,
    counted,
    frame_record,
    heard_candidate_record,
    heard_target_record,
    marker_record,
    motion_record,
    target_record,
)
from path.cycle.prior import Prior
from path.cycle.sender import PairVerdict
from path.gate.evidence import Gate
from path.geometry.rigid import inverse_as_quat, rigid
from path.geometry.transforms import Matrix
from path.messages import Candidate, Role, Target
from path.observations import Box, Depth, Detection

TARGET_ID = 1


class Journals:
    """The logs of a pair of drones that verify."""

    def __init__(self, logs: Mapping[Role, Log], needed: int) -> None:
        self._logs, self._needed = logs, needed

    def sender(
        self,
        view: View,
        target: Target,
        seen: tuple[Box, Depth | None],
        heard: Candidate,
        pairs: Sequence[PairVerdict],
        gate: Gate,
    ) -> None:
        """D1's frame, what it sent, what it heard, and what that was worth."""
        log, stamp_ns, (box, depth) = self._logs[Role.SENDER], view.stamp_ns, seen
        log.write("/frame", stamp_ns, frame_record(view, stamp_ns))
        record = target_record(target, view.frame_id, stamp_ns, box)
        record["judged_ns"] = stamp_ns
        if depth is not None:
            record["depth_m"], record["depth_sigma_m"] = depth.z_m, depth.sigma_m
        record["beside"] = beside_record(())
        log.write("/target", stamp_ns, record)
        log.write("/heard_candidate", stamp_ns, heard_candidate_record(heard, heard.capture_ns))
        for pair in pairs:
            count, evidence = counted(pair, gate)
            log.write("/agreement", stamp_ns, agreement_record(pair, count, self._needed, evidence, TARGET_ID))

    def receiver(
        self,
        view: View,
        heard: Target,
        fix: MarkerFix,
        motion: VehicleMotions,
        attitudes: tuple[Matrix, Matrix | None],
        prior: Prior,
        candidate: Candidate,
        found: Sequence[Detection],
    ) -> None:
        """D2's frame, what it heard, the marker, and its answer. ``attitudes`` are ``R_n_c`` and ``R_n_v``."""
        log, stamp_ns = self._logs[Role.RECEIVER], view.stamp_ns
        log.write("/frame", stamp_ns, frame_record(view, stamp_ns))
        log.write("/heard_target", stamp_ns, heard_target_record(heard, heard.capture_ns))
        rotation, position = inverse_as_quat(rigid(fix.T_c_v))
        xx, yy, zz, *_ = fix.covariance.diagonal().tolist()
        sigma_m = math.sqrt((xx + yy + zz) / 3.0)
        marker = marker_record(stamp_ns, position, rotation, sigma_m, fix.side_px, fix.detections[0])
        log.write("/marker", stamp_ns, marker)
        log.write("/motion", stamp_ns, motion_record(motion, *attitudes, fix))
        log.write("/candidate", stamp_ns, candidate_record(candidate, prior, found))
