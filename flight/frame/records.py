"""The records of a frame's decisions, in the fields that ``drivers.log.topics`` has."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from flight.common_view import MeasuredPose
from flight.rendezvous.marker_view import MarkerFix, VehicleMotions
from flight.tracking.association import Sighting
from flight.tracking.by_both import ByBoth
from path.common_view.estimate import CommonView, Unknown
from path.cycle.prior import Prior
from path.cycle.sender import PairVerdict
from path.gate.agreement import Agreed
from path.gate.identity import nearest_rival
from path.gate.window import Evidence, Gate
from path.geometry.rigid import inverse_as_quat, rigid
from path.geometry.rotation import quat_from_R
from path.geometry.transforms import Matrix, Pose
from path.messages import Candidate, Target
from path.observations import Box, Depth, Detection, Missed, MissReason, RangeSource
from path.target.range import Ranged
from path.target.rivals import Rival

RIVAL_NUMBERS = 6


class AttemptId(NamedTuple):
    """Which attempt a message belongs to."""

    handoff_id: int
    epoch: int
    target_id: int


class OwnFrame(NamedTuple):
    """What one frame of D1 gave.

    The target as it was seen and the message to send, or why there is none.

    ``stamp_ns``: mid-exposure, D1's clock.
    """

    frame_id: int
    stamp_ns: int
    seen: Sighting | MissReason
    message: Target | Missed


class Answer(NamedTuple):
    """D2's answer for one frame, and what it rests on."""

    candidate: Candidate
    prior: Prior | Missed
    found: Sequence[Detection]


def attempt_record(attempt: AttemptId) -> dict[str, Any]:
    """``/attempt``: from here on a cycle of its own decides."""
    return attempt._asdict()


def heard_candidate_record(candidate: Candidate, capture_ns: int) -> dict[str, Any]:
    """``/heard_candidate``: an answer of D2 as it came in; ``capture_ns`` by D1's clock."""
    return {
        "handoff_id": candidate.handoff_id,
        "epoch": candidate.epoch,
        "target_id": candidate.target_id,
        "sequence": candidate.sequence,
        "target_sequence": candidate.target_sequence,
        "peer_capture_ns": candidate.capture_ns,
        "capture_ns": capture_ns,
        "box": box_record(candidate.box),
        "reason": candidate.reason.value if candidate.reason else None,
        "position_v_m": candidate.position_v_m,
        "rotation_v_c2": candidate.rotation_v_c2,
        "sigma_m": candidate.sigma_m,
    }


def heard_target_record(target: Target, capture_ns: int) -> dict[str, Any]:
    """``/heard_target``: a message of D1 as it came in; ``capture_ns`` by D2's clock."""
    return {
        "handoff_id": target.handoff_id,
        "epoch": target.epoch,
        "target_id": target.target_id,
        "sequence": target.sequence,
        "peer_capture_ns": target.capture_ns,
        "capture_ns": capture_ns,
        "point_v_m": target.point_v_m,
        "gravity_v": target.gravity_v,
        "sigma_m": target.sigma_m,
    }


def box_record(box: Box | None) -> list[float] | None:
    return None if box is None else [box.x, box.y, box.w, box.h]


def beside_record(beside: Sequence[Rival]) -> list[float]:
    """Return the objects that D1 sees beside the target, six numbers each.

    Box, depth and its standard deviation, or 0 without.
    """
    numbers: list[float] = []
    for each in beside:
        depth = (0.0, 0.0) if each.depth is None else (each.depth.z_m, each.depth.sigma_m)
        numbers += [each.box.x, each.box.y, each.box.w, each.box.h, *depth]
    return numbers


def beside_of(numbers: Sequence[float] | None) -> tuple[Rival, ...]:
    """Read what ``beside_record`` has written."""
    rows = np.asarray(numbers or (), float).reshape(-1, RIVAL_NUMBERS).tolist()
    return tuple(
        Rival(Box(x, y, w, h), Depth(z, sigma) if z > 0.0 else None)
        for x, y, w, h, z, sigma in rows
    )


def target_record(frame: OwnFrame, judged_ns: int) -> dict[str, Any]:
    """Return ``/target``: what one frame of D1 gave.

    ``judged_ns``: when D2's answers were judged after it, D1's clock.
    """
    seen = frame.seen
    message = frame.message
    sent = isinstance(message, Target)
    sighted = isinstance(seen, Sighting)
    depth = seen.depth if sighted else None
    reason = None if isinstance(message, Target) else message.reason
    if isinstance(seen, MissReason):  # why, was said by what looked for it
        reason = seen
    return {
        "frame_id": frame.frame_id,
        "sequence": message.sequence if sent else frame.frame_id & 0xFFFF,
        "capture_ns": frame.stamp_ns,
        "judged_ns": judged_ns,
        "box": box_record(seen.box) if sighted else None,
        "depth_m": None if depth is None else depth.z_m,
        "depth_sigma_m": None if depth is None else depth.sigma_m,
        **(_range_fields(seen) if sighted else {}),
        "beside": beside_record(seen.beside) if sighted else None,
        "point_v_m": message.point_v_m if sent else None,
        "gravity_v": message.gravity_v if sent else None,
        "sigma_m": message.sigma_m if sent else None,
        "reason": None if reason is None else reason.value,
    }


def _range_fields(seen: Sighting) -> dict[str, Any]:
    """Return what the range rests on, the surest first, and what contradicts it.

    Nothing where there is no range.
    """
    if seen.depth is None or seen.ranged is None:
        return {}
    against = "+".join(each.value for each in seen.ranged.against)
    return {
        "range_by": "+".join(each.value for each in seen.ranged.by),
        "range_against": against or None,
    }


def sighting_of(record: Mapping[str, Any], box: Box) -> Sighting:
    """Read what D1 saw in the frame of a ``/target``.

    Logs from before there were several ranges have depth alone.
    """
    beside = beside_of(record["beside"])
    if record["depth_m"] is None:
        return Sighting(box, None, beside)
    by = _sources(record.get("range_by"))
    depth = Depth(record["depth_m"], record["depth_sigma_m"], by[0] if by else RangeSource.DEPTH)
    ranged = Ranged(depth, by, _sources(record.get("range_against"))) if by else None
    return Sighting(box, depth, beside, ranged)


def _sources(text: str | None) -> tuple[RangeSource, ...]:
    return tuple(RangeSource(each) for each in text.split("+")) if text else ()


def agreement_record(
    pair: PairVerdict, gate: Gate, needed_pairs: int, target_id: int
) -> dict[str, Any]:
    """``/agreement``: what one answer of D2 was worth."""
    verdict = pair.verdict
    candidate = pair.candidate
    offsets = pair.offsets
    agreed = isinstance(verdict, Agreed)
    count, evidence = counted(pair, gate)
    return {
        "agreed": agreed,
        "counted": agreed or not verdict.ignored,
        "reason": None if agreed else verdict.reason.value,
        "iou": verdict.iou,
        "tau": pair.tau,
        "count": count,
        "needed": needed_pairs,
        "evidence": evidence.reached if evidence else None,
        "evidence_needed": evidence.needed if evidence else None,
        "capture_ns": pair.capture_ns,
        "sequence": candidate.sequence if candidate else None,
        "target_sequence": candidate.target_sequence if candidate else None,
        "target_id": target_id,
        "epoch": candidate.epoch if candidate else None,
        "own_box": box_record(pair.own_box),
        "mapped_box": box_record(pair.mapped_box),
        "offset_m": None if offsets is None else offsets.target_m,
        "rival_offset_m": None if offsets is None else nearest_rival(offsets),
        "oversize": None if pair.own_box is None else pair.oversize,
        "placed_iou": pair.placed_iou,
    }


def counted(pair: PairVerdict, gate: Gate) -> tuple[int, Evidence | None]:
    """Count and evidence as of this pair: the gate may already have seen the next."""
    verdict = pair.verdict
    return (
        (verdict.count, verdict.evidence)
        if isinstance(verdict, Agreed)
        else (gate.count, gate.evidence)
    )


def marker_record(stamp_ns: int, fix: MarkerFix | Missed) -> dict[str, Any]:
    """``/marker``: the pose of D2's camera in the marker's frame, or why one frame gave none."""
    if isinstance(fix, Missed):
        return {
            "capture_ns": stamp_ns,
            "position_v_m": None,
            "corners_px": None,
            "reason": fix.reason.value,
            "cause": fix.cause,
        }
    rotation, position = inverse_as_quat(rigid(fix.T_c_v))
    xx, yy, zz, *_ = fix.covariance.diagonal().tolist()
    return {
        "capture_ns": stamp_ns,
        "position_v_m": position,
        "rotation_v_c2": rotation,
        "sigma_m": math.sqrt((xx + yy + zz) / 3.0),
        "side_px": fix.side_px,
        **_carrying_fields(fix),
        "reason": None,
        "cause": None,
    }


def _carrying_fields(fix: MarkerFix) -> dict[str, Any]:
    """Return the corners that a pose rests on, or that it rests on none."""
    if not fix.detections:
        return {"corners_px": None, "carried_by": fix.carried_by.value}
    return {"corners_px": fix.detections[0].corners_px.reshape(-1).tolist()}


def common_view_record(
    stamp_ns: int,
    age_s: float,
    found: CommonView | Unknown,
    measured: MeasuredPose | None,
    refused: Missed | None,
) -> dict[str, Any]:
    """Return ``/common_view``: what D1's newest keyframe and a frame of D2 gave.

    ``age_s``: of the keyframe.
    """
    best = found if isinstance(found, CommonView) else found.best
    sigma_m = None
    if measured is not None:
        sigma_m = math.sqrt(float(np.trace(measured.covariance[:3, :3])) / 3.0)
    return {
        "capture_ns": stamp_ns,
        "age_s": age_s,
        "why": None if isinstance(found, CommonView) else found.why.value,
        "refused": None if refused is None else refused.reason.value,
        "T_c_v": None if measured is None else pose_rows(measured.T_c_v),
        "sigma_m": sigma_m,
        "corners": None if best is None else best.corners,
        "evidence": None if best is None else best.evidence,
        "agreement": None if best is None else best.agreement,
        "conflict": None if best is None else best.conflict,
    }


def motion_record(
    motion: VehicleMotions, R_n_c: Matrix, R_n_v: Matrix | None, fix: MarkerFix | Missed
) -> dict[str, Any]:
    """``/motion``: what the relative-pose filter was given with one frame."""
    return {
        "own_stamp_ns": motion.own_stamp_ns,
        "own_n_mps": motion.own_n_mps,
        "peer_stamp_ns": motion.peer_stamp_ns,
        "peer_n_mps": motion.peer_n_mps,
        "peer_yaw_rad": motion.peer_yaw_rad,
        "q_n_c": quat_from_R(R_n_c),
        "q_n_v": None if R_n_v is None else quat_from_R(R_n_v),
        "T_c_v": pose_rows(fix.T_c_v) if isinstance(fix, MarkerFix) else None,
        "covariance": fix.covariance.ravel().tolist() if isinstance(fix, MarkerFix) else None,
    }


def candidate_record(answer: Answer) -> dict[str, Any]:
    """``/candidate``: what D2 answered for one frame."""
    candidate, prior, found = answer
    known = prior if isinstance(prior, Prior) else None
    region = None if known is None else known.region
    return {
        "epoch": candidate.epoch,
        "sequence": candidate.sequence,
        "target_sequence": candidate.target_sequence,
        "capture_ns": candidate.capture_ns,
        "box": box_record(candidate.box),
        "reason": candidate.reason.value if candidate.reason else None,
        "position_v_m": candidate.position_v_m,
        "rotation_v_c2": candidate.rotation_v_c2,
        "sigma_m": candidate.sigma_m,
        "point_v_m": None if known is None else known.point_v_m,
        "prior_px": None if known is None else known.pixel,
        "region": [region.x0, region.y0, region.x1, region.y1] if region else None,
        "found": [{"box": box_record(each.box), "score": each.score} for each in found],
    }


def both_record(candidate: Candidate, both: ByBoth) -> dict[str, Any]:
    """Return ``/both_views``: where D2 reckons the target by both drones' views."""
    return {
        "sequence": candidate.sequence,
        "point_v_m": both.point_v_m,
        "sigma_m": both.sigma_m,
        "depth_m": both.depth.z_m,
        "depth_sigma_m": both.depth.sigma_m,
        "range_by": both.depth.source.value,
        "chi2": both.chi2,
        "agree": both.agree,
    }


def pose_rows(pose: Pose) -> list[float]:
    """The upper three rows of its matrix, one after another."""
    (a, b, c), (d, e, f), (g, h, i) = pose.R.tolist()
    x, y, z = pose.t.tolist()
    return [a, b, c, x, d, e, f, y, g, h, i, z]
