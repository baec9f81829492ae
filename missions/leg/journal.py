"""Decisions as log records, in the fields that ``missions.report.records`` lists."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from drivers.interfaces import View
from drivers.log.topics import camera_record
from drivers.operator.interfaces import BearingTold, Chosen, PlaceTold, Question, RegionTold, Told
from drivers.rig.parts import Rig
from flight.config import MissionConfig
from flight.estimator_steps import Step
from flight.rendezvous.marker_view import MarkerFix, VehicleMotions
from flight.tracking.acquisition import Taken
from flight.tracking.association import Sighting
from path.cycle.prior import Prior
from path.cycle.sender import PairVerdict
from path.gate.agreement import Agreed
from path.gate.identity import nearest_rival
from path.gate.window import Evidence, Gate
from path.geometry.rotation import quat_from_R
from path.geometry.transforms import Matrix, Pose
from path.messages import Candidate, Role, Target
from path.observations import Box, Depth, Detection, MarkerDetection, Missed, MissReason, RangeSource
from path.target.range import Ranged
from path.target.rivals import Rival

RIVAL_NUMBERS = 6


def setup_record(rig: Rig, role: Role, config: MissionConfig) -> dict[str, Any]:
    """``/setup``: what a program was given, as far as its decisions and pictures of them depend on it."""
    own, peer = (rig.sender, rig.receiver) if role is Role.SENDER else (rig.receiver, rig.sender)
    origin = rig.origin
    return {
        "role": role.value,
        "rig": rig.name,
        "level": rig.level,
        "handoff_id": config.handoff_id,
        "target_id": config.target_id,
        "method": asdict(rig.method),
        "mission": asdict(config),
        "camera": camera_record(own.camera),
        "peer_camera": camera_record(peer.camera),
        "T_b_c": _rows(own.mount.T_b_c),
        "T_b_v": _rows(rig.sender.mount.T_b_v),
        "T_v_c1": _rows(rig.sender.mount.T_v_c),
        "markers_v_m": np.concatenate([marker.corners_v.ravel() for marker in rig.layout.markers]),
        "origin": [origin.latitude_deg, origin.longitude_deg, origin.altitude_m],
        "fence_m": [config.guard.fence_radius_m, config.guard.fence_height_m],
    }


def estimator_step_record(step: Step) -> dict[str, Any]:
    """``/estimator_step``: what a vehicle's estimate stepped by."""
    return {
        "before_ns": step.before_ns,
        "shift_n_m": step.shift_n_m,
        "turn_rad": step.turn_rad,
        "counted": step.counted,
    }


def _rows(pose: Pose) -> list[float]:
    """The upper three rows of its matrix, one after another."""
    (a, b, c), (d, e, f), (g, h, i) = pose.R.tolist()
    x, y, z = pose.t.tolist()
    return [a, b, c, x, d, e, f, y, g, h, i, z]


def attempt_record(handoff_id: int, epoch: int, target_id: int) -> dict[str, Any]:
    """``/attempt``: from here on a cycle of its own decides."""
    return {"handoff_id": handoff_id, "epoch": epoch, "target_id": target_id}


def heard_candidate_record(candidate: Candidate, capture_ns: int) -> dict[str, Any]:
    """``/heard_candidate``: an answer of D2 as it came in; ``capture_ns`` by D1's clock."""
    return {
        **attempt_record(candidate.handoff_id, candidate.epoch, candidate.target_id),
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
        **attempt_record(target.handoff_id, target.epoch, target.target_id),
        "sequence": target.sequence,
        "peer_capture_ns": target.capture_ns,
        "capture_ns": capture_ns,
        "point_v_m": target.point_v_m,
        "gravity_v": target.gravity_v,
        "sigma_m": target.sigma_m,
    }


def box_record(box: Box | None) -> list[float] | None:
    return None if box is None else [box.x, box.y, box.w, box.h]


def told_record(told: Told | Chosen, *, used: bool) -> dict[str, Any]:
    """``/told``: what was said of which object is meant, places in this drone's own frame."""
    record: dict[str, Any] = {"used": used, "kind": "region", "at_ns": None}
    if isinstance(told, Chosen):
        return {**record, "kind": "choice", "question": told.question, "number": told.number}
    record["at_ns"] = told.stamp_ns
    if isinstance(told, PlaceTold):
        place = {"place_n_m": told.place_n_m, "error_m": told.error_m, "height_told": told.height_told}
        moves = {"velocity_n_mps": told.velocity_n_mps, "holds_s": told.holds_s}
        return {**record, "kind": "place", **place, **moves}
    if isinstance(told, BearingTold):
        seen = {"from_n_m": told.from_n_m, "bearing_rad": told.bearing_rad, "error_rad": told.error_rad}
        return {**record, "kind": "bearing", **seen}
    return {**record, "corners_n_m": [number for corner in told.corners_n_m for number in corner]}


def told_of(record: Mapping[str, Any]) -> Told | Chosen:
    """Read what ``told_record`` has written."""
    kind, at_ns = record["kind"], record["at_ns"]
    if kind == "choice":
        return Chosen(record["question"], record["number"])
    if kind == "place":
        north, east, down = record["place_n_m"]
        moves = record.get("velocity_n_mps")
        velocity = None if moves is None else (moves[0], moves[1])
        place = (north, east, down)
        return PlaceTold(at_ns, place, record["error_m"], record["height_told"], velocity, record["holds_s"])
    if kind == "bearing":
        north, east = record["from_n_m"]
        return BearingTold(at_ns, (north, east), record["bearing_rad"], record["error_rad"])
    flat = record["corners_n_m"]
    return RegionTold(at_ns, tuple((flat[k], flat[k + 1]) for k in range(0, len(flat), 2)))


def question_record(question: Question) -> dict[str, Any]:
    """``/question``: the objects of one frame of which somebody is asked which one is meant."""
    return {
        "number": question.number,
        "capture_ns": question.stamp_ns,
        "shown": [
            {"number": each.number, "box": box_record(each.box), "place_n_m": each.place_n_m, "share": each.share}
            for each in question.shown
        ],
    }


def taken_record(taken: Taken) -> dict[str, Any]:
    """``/taken``: the object that was taken for the target, in the frame with this stamp."""
    return {
        "position_n_m": taken.position_n_m,
        "velocity_n_mps": taken.velocity_n_mps,
        "share": taken.share,
        "chosen": taken.chosen,
    }


def beside_record(beside: Sequence[Rival]) -> list[float]:
    """Objects that D1 sees beside the target, six numbers each: box, depth and its standard deviation, or 0 without."""
    numbers: list[float] = []
    for each in beside:
        depth = (0.0, 0.0) if each.depth is None else (each.depth.z_m, each.depth.sigma_m)
        numbers += [each.box.x, each.box.y, each.box.w, each.box.h, *depth]
    return numbers


def beside_of(numbers: Sequence[float] | None) -> tuple[Rival, ...]:
    """Reads what ``beside_record`` has written."""
    rows = np.asarray(numbers or (), float).reshape(-1, RIVAL_NUMBERS).tolist()
    return tuple(Rival(Box(x, y, w, h), Depth(z, sigma) if z > 0.0 else None) for x, y, w, h, z, sigma in rows)


def range_record(seen: Sighting) -> dict[str, Any]:
    """Of a ``/target``: what the range rests on, the surest first, and what contradicts it."""
    ranged = seen.ranged
    if ranged is None:
        return {}
    against = "+".join(each.value for each in ranged.against)
    return {"range_by": "+".join(each.value for each in ranged.by), "range_against": against or None}


def sighting_of(record: Mapping[str, Any], box: Box) -> Sighting:
    """Reads what D1 saw in the frame of a ``/target``; logs from before there were several ranges have depth alone."""
    beside = beside_of(record["beside"])
    if record["depth_m"] is None:
        return Sighting(box, None, beside)
    by = _sources(record.get("range_by"))
    depth = Depth(record["depth_m"], record["depth_sigma_m"], by[0] if by else RangeSource.DEPTH)
    return Sighting(box, depth, beside, Ranged(depth, by, _sources(record.get("range_against"))) if by else None)


def _sources(text: str | None) -> tuple[RangeSource, ...]:
    return tuple(RangeSource(each) for each in text.split("+")) if text else ()


def frame_record(view: View, now_ns: int, T_n_c: Pose | None = None) -> dict[str, Any]:
    """``/frame``: which frame a cycle is of, and how long after its capture the cycle began.

    ``T_n_c``: the camera's pose as believed, where perception may be run again and needs it.
    """
    record: dict[str, Any] = {"frame_id": view.frame_id, "age_ns": now_ns - view.stamp_ns}
    return record if T_n_c is None else {**record, "T_n_c": _rows(T_n_c)}


def track_record(seen: Sighting | MissReason) -> dict[str, Any]:
    """``/track``: what one frame gave a drone that follows the target on its own."""
    return {
        "box": box_record(seen.box) if isinstance(seen, Sighting) else None,
        "reason": seen.value if isinstance(seen, MissReason) else None,
    }


def target_record(message: Target | Missed, frame_id: int, capture_ns: int, box: Box | None) -> dict[str, Any]:
    """``/target``: what one frame of D1 gave."""
    sent = isinstance(message, Target)
    return {
        "frame_id": frame_id,
        "sequence": message.sequence if sent else frame_id & 0xFFFF,
        "capture_ns": capture_ns,
        "box": box_record(box),
        "point_v_m": message.point_v_m if sent else None,
        "gravity_v": message.gravity_v if sent else None,
        "sigma_m": message.sigma_m if sent else None,
        "reason": None if sent else message.reason.value,
    }


def agreement_record(
    pair: PairVerdict, count: int, needed: int, evidence: Evidence | None, target_id: int
) -> dict[str, Any]:
    """``/agreement``: what one answer of D2 was worth."""
    verdict, candidate, offsets = pair.verdict, pair.candidate, pair.offsets
    agreed = isinstance(verdict, Agreed)
    return {
        "agreed": agreed,
        "counted": agreed or not verdict.ignored,
        "reason": None if agreed else verdict.reason.value,
        "iou": verdict.iou,
        "tau": pair.tau,
        "count": count,
        "needed": needed,
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
    return (verdict.count, verdict.evidence) if isinstance(verdict, Agreed) else (gate.count, gate.evidence)


def marker_record(
    capture_ns: int, position_v_m: Any, rotation_v_c2: Any, sigma_m: float, side_px: float, found: MarkerDetection
) -> dict[str, Any]:
    """``/marker``: a pose of D2's camera in the marker's frame."""
    return {
        "capture_ns": capture_ns,
        "position_v_m": position_v_m,
        "rotation_v_c2": rotation_v_c2,
        "sigma_m": sigma_m,
        "side_px": side_px,
        "corners_px": found.corners_px.reshape(-1).tolist(),
        "reason": None,
        "cause": None,
    }


def marker_miss_record(capture_ns: int, missed: Missed) -> dict[str, Any]:
    """``/marker`` of a frame without a pose."""
    return {
        "capture_ns": capture_ns,
        "position_v_m": None,
        "corners_px": None,
        "reason": missed.reason.value,
        "cause": missed.cause,
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
        "T_c_v": _rows(fix.T_c_v) if isinstance(fix, MarkerFix) else None,
        "covariance": fix.covariance.ravel().tolist() if isinstance(fix, MarkerFix) else None,
    }


def candidate_record(candidate: Candidate, prior: Prior | Missed, found: Sequence[Detection]) -> dict[str, Any]:
    """``/candidate``: what D2 answered for one frame."""
    looked = isinstance(prior, Prior)
    region = prior.region if looked else None
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
        "point_v_m": prior.point_v_m if looked else None,
        "prior_px": prior.pixel if looked else None,
        "region": [region.x0, region.y0, region.x1, region.y1] if region else None,
        "found": [{"box": box_record(each.box), "score": each.score} for each in found],
    }
