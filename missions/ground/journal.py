"""Decisions as log records, in the fields that ``missions.look.report.records`` lists."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from drivers.interfaces import View
from drivers.log.topics import camera_record
from drivers.operator.interfaces import BearingTold, Chosen, PlaceTold, Question, RegionTold, Told
from drivers.rig.parts import Rig
from flight.config import MissionConfig
from flight.estimator_steps import Step
from flight.frame.records import box_record, pose_rows
from flight.outcome import name_of
from flight.phases import Phase
from flight.tracking.acquisition import Taken
from flight.tracking.association import Sighting
from flight.tracking.ranging import Ground
from path.geometry.transforms import Pose
from path.messages import Role, Status
from path.observations import MissReason, RangeSource


def setup_record(
    rig: Rig,
    role: Role,
    config: MissionConfig,
) -> dict[str, Any]:
    """``/setup``: what a program was given, as far as its decisions and pictures of them depend on
    it.
    """
    own, peer = (rig.sender, rig.receiver) if role is Role.SENDER else (rig.receiver, rig.sender)
    origin = rig.origin
    mission = asdict(config)
    for key in ("obstacles", "unmeasured"):
        if not mission["guard"][key]:
            del mission["guard"][key]
    return {
        "role": role.value,
        "rig": rig.name,
        "level": rig.level,
        "handoff_id": config.handoff_id,
        "target_id": config.target_id,
        "method": asdict(rig.method),
        "mission": mission,
        "camera": camera_record(own.camera),
        "peer_camera": camera_record(peer.camera),
        "T_b_c": pose_rows(own.mount.T_b_c),
        "T_b_v": pose_rows(rig.sender.mount.T_b_v),
        "T_v_c1": pose_rows(rig.sender.mount.T_v_c),
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


def peer_record(status: Status) -> dict[str, Any]:
    """``/peer``: what the other drone said of itself."""
    return {
        "role": status.role.value,
        "phase": Phase(status.phase).title if status.phase in set(Phase) else "",
        "position_n_m": status.position_n_m,
        "velocity_n_mps": status.velocity_n_mps,
        "yaw_rad": status.yaw_rad,
        "responsible": status.responsible,
        "battery": status.battery,
        "ended": name_of(status.ended) if status.ended else "",
    }


def told_record(told: Told | Chosen, *, used: bool) -> dict[str, Any]:
    """``/told``: what was said of which object is meant, places in this drone's own frame."""
    record: dict[str, Any] = {"used": used, "kind": "region", "at_ns": None}
    if isinstance(told, Chosen):
        return {**record, "kind": "choice", "question": told.question, "number": told.number}
    record["at_ns"] = told.stamp_ns
    if isinstance(told, PlaceTold):
        place = {
            "place_n_m": told.place_n_m,
            "error_m": told.error_m,
            "height_told": told.height_told,
        }
        moves = {"velocity_n_mps": told.velocity_n_mps, "holds_s": told.holds_s}
        return {**record, "kind": "place", **place, **moves}
    if isinstance(told, BearingTold):
        seen = {
            "from_n_m": told.from_n_m,
            "bearing_rad": told.bearing_rad,
            "error_rad": told.error_rad,
        }
        return {**record, "kind": "bearing", **seen}
    return {**record, "corners_n_m": [number for corner in told.corners_n_m for number in corner]}


def told_of(record: Mapping[str, Any]) -> Told | Chosen:
    """Read what ``told_record`` has written."""
    kind = record["kind"]
    at_ns = record["at_ns"]
    if kind == "choice":
        return Chosen(record["question"], record["number"])
    if kind == "place":
        north, east, down = record["place_n_m"]
        moves = record.get("velocity_n_mps")
        velocity = None if moves is None else (moves[0], moves[1])
        place = (north, east, down)
        return PlaceTold(
            at_ns,
            place,
            record["error_m"],
            record["height_told"],
            velocity,
            record["holds_s"],
        )
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
            {
                "number": each.number,
                "box": box_record(each.box),
                "place_n_m": each.place_n_m,
                "share": each.share,
            }
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


def frame_record(
    view: View,
    now_ns: int,
    T_n_c: Pose | None = None,
    ground: Ground | None = None,
) -> dict[str, Any]:
    """``/frame``: which frame a cycle is of, and how long after its capture the cycle began.

    ``T_n_c``: the camera's pose as believed, where perception may be run again and needs it, and
    the ``ground`` then.
    """
    record: dict[str, Any] = {"frame_id": view.frame_id, "age_ns": now_ns - view.stamp_ns}
    if ground is not None:
        own = {
            "ground_down_m": ground.down_m,
            "ground_sigma_m": ground.sigma_m,
            "ground_by": ground.source.value,
        }
        record |= own
    return record if T_n_c is None else {**record, "T_n_c": pose_rows(T_n_c)}


def ground_of(record: Mapping[str, Any]) -> Ground | None:
    """Read the ground of a ``/frame``."""
    if record.get("ground_down_m") is None:
        return None
    return Ground(
        record["ground_down_m"],
        record["ground_sigma_m"],
        RangeSource(record["ground_by"]),
    )


def track_record(seen: Sighting | MissReason) -> dict[str, Any]:
    """``/track``: what one frame gave a drone that follows the target on its own."""
    return {
        "box": box_record(seen.box) if isinstance(seen, Sighting) else None,
        "reason": seen.value if isinstance(seen, MissReason) else None,
    }
