"""Every topic that PATH logs as JSON: its fields, with their units, and what one record of it is.

The one place they are told from: JSON Schemas in the logs, what a reader fills in, and docs/logs.md. A field that does
not apply is left out of a record and comes back as null. The schemas use only what Foxglove's reader of them
understands: one type a field, and no list of lists.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import msgspec

from path.camera.model import CameraModel

Schema = dict[str, Any]


def _field(kind: str, text: str, **more: Any) -> Schema:
    return {"type": kind, "description": text, **more}


def _number(text: str) -> Schema:
    return _field("number", text)


def _whole(text: str) -> Schema:
    return _field("integer", text)


def _text(text: str) -> Schema:
    return _field("string", text)


def _flag(text: str) -> Schema:
    return _field("boolean", text)


def _numbers(text: str) -> Schema:
    return _field("array", text, items={"type": "number"})


def _table(text: str, **fields: Schema) -> Schema:
    """A nested record; without fields: names that are not known beforehand."""
    return _field("object", text, properties=fields)


def _tables(text: str, **fields: Schema) -> Schema:
    return _field("array", text, items={"type": "object", "properties": fields})


def _box(text: str) -> Schema:
    return _numbers(f"[x, y, w, h] in px, x and y the top left corner: {text}")


def _reason(text: str) -> Schema:
    return _text(f"why not, of path.observations.MissReason: {text}")


def _pose(text: str) -> Schema:
    return _table(text, t=_numbers("position in m"), q=_numbers("rotation, quaternion wxyz"))


_INTRINSICS = ("width", "height", "fx", "fy", "cx", "cy", "distortion")


def camera_record(camera: CameraModel) -> dict[str, Any]:
    """Intrinsics as they are logged, and what a calibration says beyond them."""
    record = {name: getattr(camera, name) for name in _INTRINSICS}
    record["doubts"] = [one for doubt in camera.doubts for one in doubt]
    return record if camera.thinning is None else {**record, "thinning": asdict(camera.thinning)}


_CAPTURE = _whole("capture of the frame, ns of this log's own clock")
_CAMERA = {
    "width": _whole("px"),
    "height": _whole("px"),
    "fx": _number("focal length, px"),
    "fy": _number("focal length, px"),
    "cx": _number("principal point, px"),
    "cy": _number("principal point, px"),
    "distortion": _numbers("Brown-Conrady, OpenCV's order"),
    "doubts": _numbers("by how much fx, fy, cx, cy, k1, k2, p1, p2, k3 are off together: nine for each cause"),
    "thinning": _table(
        "how the camera leaves out pixels",
        kept=_whole("pixels of the image ..."),
        of=_whole("... for so many of the sensor"),
        begins=_numbers("where the pattern begins, column and row, px"),
    ),
}
_ATTEMPT = {
    "handoff_id": _whole("of the mission"),
    "epoch": _whole("of the attempt; it only grows"),
    "target_id": _whole("of the target"),
}
_MOUNT = {
    "T_b_c": _pose("camera to the body (FRD) of its drone"),
    "T_b_v": _pose("marker frame to the body (FRD) of the sender"),
}


@dataclass(frozen=True, slots=True)
class Topic:
    """The meaning of one topic's records, and their fields as JSON Schemas."""

    text: str
    fields: dict[str, Schema]


TOPICS: dict[str, Topic] = {
    # --- any drone ---
    "/setup": Topic(
        "what the program was given; first. Poses are the upper three rows of their matrices, one after another",
        {
            "role": _text("sender (D1) or receiver (D2)"),
            "rig": _text("its name"),
            "level": _text("sim, sim-rendered, sitl, hitl or field"),
            "handoff_id": _whole("of the mission"),
            "target_id": _whole("of the target"),
            "method": _table("settings of the method: path.config.MethodConfig"),
            "mission": _table("settings of the mission: flight.config.MissionConfig"),
            "camera": _table("this drone's", **_CAMERA),
            "peer_camera": _table("the other drone's", **_CAMERA),
            "T_b_c": _numbers("this drone's camera to its body (FRD), m"),
            "T_b_v": _numbers("the marker's frame to the sender's body (FRD), m"),
            "T_v_c1": _numbers("the sender's camera to the marker's frame, m"),
            "markers_v_m": _numbers("x, y, z of the four corners of every marker, marker's frame, m"),
            "origin": _numbers("latitude and longitude in degrees, altitude in m, of the local frame's zero"),
            "fence_m": _numbers("radius about the origin and height, beyond which nothing is flown, m"),
        },
    ),
    "/frame": Topic(
        "a camera frame whose cycle began; the stamp is the capture",
        {
            "frame_id": _whole("of the camera; it only grows"),
            "age_ns": _whole("capture to begin of the cycle, ns"),
            "T_n_c": _numbers("camera to north-east-down as believed, of D1 with record = all: rows of its matrix, m"),
        },
    ),
    "/recording": Topic(
        "frames recorded beside the log, once a second; counters are from the program's start",
        {
            "taken": _whole("frames that were to be recorded"),
            "dropped": _whole("of them not recorded: encoder or disk did not keep up"),
            "bytes": _whole("of the file"),
            "spent_ns": _whole("of processor, in real time only, ns"),
        },
    ),
    "/cpu": Topic(
        "processor time, once a second, in real time only",
        {"spent_ns": _table("ns since the start by stage; thread: the main thread; program: all threads")},
    ),
    "/shed": Topic(
        "something is given up because the computer does not keep up, or taken up again; in real time only",
        {
            "what": _text("of flight.shedding.IN_ORDER"),
            "gone": _flag("given up, not taken up again"),
            "busy": _number("share of the time at work before, 0 to 1"),
        },
    ),
    "/phase": Topic("a phase of the course begins", {"phase": _text("its name"), "note": _text("for the crew")}),
    "/note": Topic("a line for the crew", {"note": _text("the line")}),
    "/state": Topic(
        "where the vehicle believes to be, ten times a second",
        {
            "position_n_m": _numbers("north, east, down in m from the origin of the rig"),
            "velocity_n_mps": _numbers("north, east, down in m/s"),
            "q_n_b": _numbers("attitude, quaternion wxyz, body (FRD) to north-east-down"),
            "mode": _text("flight mode"),
            "armed": _flag("motors may turn"),
            "battery": _number("what is left, 0 to 1"),
        },
    ),
    "/setpoint": Topic(
        "what the vehicle was told",
        {"velocity_n_mps": _numbers("north, east, down in m/s"), "yaw_rad": _number("heading from north, rad")},
    ),
    "/doubt": Topic(
        "whether the pilot has taken the vehicle is not known for a moment",
        {"mode": _text("flight mode as heard"), "armed": _flag("motors may turn")},
    ),
    "/responsibility": Topic(
        "whose the target is, when that changes",
        {
            "responsible": _flag("this drone's"),
            "until_ns": _whole("end of its lease, own clock; left out: for good. Nobody need say that it is over"),
        },
    ),
    "/link": Topic(
        "the link between the drones, once a second; counters are from the program's start",
        {
            "packets_sent": _whole("packets"),
            "packets_received": _whole("packets"),
            "bytes_sent": _whole("bytes, UDP and IP headers included"),
            "bytes_received": _whole("bytes, UDP and IP headers included"),
            "dropped": _table("packets by reason"),
            "clock_offset_ns": _whole("clock of the other drone minus this one's, ns"),
            "clock_uncertainty_ns": _whole("bound on the error of that, ns"),
        },
    ),
    "/track": Topic(
        "a drone that follows the target on its own: what a frame gave",
        {"box": _box("the target"), "reason": _reason("there is no box")},
    ),
    "/outcome": Topic(
        "the end of the program",
        {
            "outcome": _text("see docs/faults.md"),
            "detail": _text("what was seen"),
            "responsible": _flag("for the target, at the end"),
            "landed": _flag("by the script"),
        },
    ),
    # --- protocol of the hand-over ---
    "/commit": Topic(
        "D1 gives the target away, until the lease's end",
        {
            "target_id": _whole("of the target"),
            "epoch": _whole("of the attempt"),
            "nonce": _whole("by chance"),
            "lease_end_ns": _whole("ns of D1's clock"),
        },
    ),
    "/epoch": Topic(
        "what was written down to survive a restart",
        {"epoch": _whole("of the attempt"), "duty": _text("what the drone has to do about it")},
    ),
    "/decision": Topic(
        "how an attempt ended",
        {"outcome": _text("path.protocol.values.HandoffOutcome"), "reason": _text("of an abort")},
    ),
    "/settled": Topic(
        "what became known later of an attempt", {"outcome": _text("path.protocol.values.HandoffOutcome")}
    ),
    "/refused": Topic("what the protocol did not let happen", {"why": _text("path.protocol.values.Refusal")}),
    "/attempt": Topic("from here on a cycle of its own decides: another attempt", _ATTEMPT),
    # --- D1 ---
    "/heard_candidate": Topic(
        "an answer of D2 as it came in, once the clocks are aligned",
        {
            **_ATTEMPT,
            "sequence": _whole("low 16 bits of D2's frame"),
            "target_sequence": _whole("of the message of D1 that it answers"),
            "peer_capture_ns": _whole("of D2's frame, ns of D2's clock"),
            "capture_ns": _whole("the same, ns of D1's clock"),
            "box": _box("what D2 takes for the target"),
            "reason": _reason("there is no box"),
            "position_v_m": _numbers("of D2's camera in the marker's frame, m"),
            "rotation_v_c2": _numbers("camera to marker's frame, quaternion wxyz"),
            "sigma_m": _number("standard deviation of the position, each axis, m"),
        },
    ),
    "/target": Topic(
        "one frame of D1: the message sent to D2, or why there is none",
        {
            "frame_id": _whole("of the camera"),
            "sequence": _whole("low 16 bits of that"),
            "capture_ns": _CAPTURE,
            "judged_ns": _whole("when answers of D2 were judged after it, ns of this log's clock"),
            "box": _box("the target as tracked"),
            "depth_m": _number("of the target along the optical axis, m"),
            "depth_sigma_m": _number("standard deviation of that, m"),
            "point_v_m": _numbers("the target in the marker's frame, m"),
            "gravity_v": _numbers("direction of gravity in the marker's frame, unit vector"),
            "sigma_m": _number("standard deviation of the point, m"),
            "reason": _reason("nothing was sent"),
            "beside": _numbers(
                "objects beside the target, six each: box x y w h in px, depth, its deviation in m or 0"
            ),
        },
    ),
    "/agreement": Topic(
        "D1 judged an answer of D2, or that none came",
        {
            "agreed": _flag("both views show the same thing"),
            "counted": _flag("it advanced or restarted the count"),
            "reason": _reason("it did not agree"),
            "iou": _number("overlap of D1's box and D2's mapped one, 0 to 1"),
            "tau": _number("overlap that was needed; left out when nothing was compared"),
            "count": _whole("agreeing pairs in a row"),
            "needed": _whole("of them for a hand-over"),
            "evidence": _number("of the gate by evidence, nats"),
            "evidence_needed": _number("nats"),
            "capture_ns": _whole("of D2's frame, ns of D1's clock"),
            "sequence": _whole("of D2's answer"),
            "target_sequence": _whole("of the frame of D1 that D2 used"),
            "target_id": _whole("of the target"),
            "epoch": _whole("of the answer"),
            "own_box": _box("D1's, at the capture of D2's frame"),
            "mapped_box": _box("D2's, mapped into D1's image"),
            "offset_m": _numbers("of D2's box from D1's, in D1's image at the target's depth, m"),
            "rival_offset_m": _numbers("the same from the nearest other object that D1 sees, m"),
            "oversize": _number("by how much a box is larger than the target can be, standard deviations"),
            "placed_iou": _number("overlap with D2's box where a body of the stated size has its middle, 0 to 1"),
        },
    ),
    # --- D2 ---
    "/heard_target": Topic(
        "a message of D1 as it came in, once the clocks are aligned",
        {
            **_ATTEMPT,
            "sequence": _whole("low 16 bits of D1's frame"),
            "peer_capture_ns": _whole("of D1's frame, ns of D1's clock"),
            "capture_ns": _whole("the same, ns of D2's clock"),
            "point_v_m": _numbers("the target in the marker's frame, m"),
            "gravity_v": _numbers("direction of gravity in the marker's frame, unit vector"),
            "sigma_m": _number("standard deviation of the point, m"),
        },
    ),
    "/marker": Topic(
        "one frame of D2: its camera in the frame of D1's marker",
        {
            "capture_ns": _CAPTURE,
            "position_v_m": _numbers("of the camera in the marker's frame, m"),
            "rotation_v_c2": _numbers("camera to marker's frame, quaternion wxyz"),
            "sigma_m": _number("standard deviation of the position, each axis, m"),
            "side_px": _number("side of the marker in the image, px"),
            "corners_px": _numbers("u, v of the four corners, px; the first marker of several"),
            "reason": _reason("there is no pose"),
        },
    ),
    "/motion": Topic(
        "with each /marker, what the filter of the relative pose was given",
        {
            "own_stamp_ns": _whole("of the vehicle's own velocity, ns"),
            "own_n_mps": _numbers("north, east, down in m/s"),
            "peer_stamp_ns": _whole("of the other drone's velocity, ns of this log's clock"),
            "peer_n_mps": _numbers("north, east, down in m/s"),
            "peer_yaw_rad": _number("heading of the other drone from north, rad"),
            "q_n_c": _numbers("camera to north-east-down as reported, quaternion wxyz"),
            "q_n_v": _numbers("marker's frame to north-east-down as reported, quaternion wxyz"),
            "T_c_v": _numbers("the marker's pose in the camera: three rows of its matrix, one after another, m"),
            "covariance": _numbers("of that pose, 6 x 6 by rows; convention of path.cycle.prior"),
        },
    ),
    "/candidate": Topic(
        "D2's answer for one frame",
        {
            "epoch": _whole("of the attempt"),
            "sequence": _whole("low 16 bits of the frame's id"),
            "target_sequence": _whole("of the newest message of D1 that was used"),
            "capture_ns": _CAPTURE,
            "box": _box("what D2 takes for the target"),
            "reason": _reason("there is no box"),
            "position_v_m": _numbers("of D2's camera in the marker's frame, m"),
            "rotation_v_c2": _numbers("camera to marker's frame, quaternion wxyz"),
            "sigma_m": _number("standard deviation of the position, each axis, m"),
            "point_v_m": _numbers("the target's point as carried to the capture, marker's frame, m"),
            "prior_px": _numbers("[u, v] where the target must appear, px"),
            "region": _numbers("[x0, y0, x1, y1] of the image that was searched, px"),
            "found": _tables(
                "what the detector found there", box=_numbers("[x, y, w, h], px"), score=_number("0 to 1")
            ),
        },
    ),
    # --- guard ---
    "/guard": Topic(
        "a decision of the guard",
        {
            "stage": _text("of the guard"),
            "act": _text("what it does"),
            "reason": _text("why"),
            "beat_age_s": _number("since the script's last beat, s"),
            "mode": _text("flight mode as heard"),
        },
    ),
    "/guard_view": Topic(
        "the vehicle as its guard sees it, twice a second",
        {
            "armed": _flag("motors may turn"),
            "in_air": _flag("as the vehicle says"),
            "mode": _text("flight mode"),
            "position_n_m": _numbers("north, east, down in m from the origin of the rig"),
            "battery": _number("what is left, 0 to 1"),
            "script": _text("what the script said it does"),
            "ignored": _table("what came and was not believed: how often, by what it was"),
        },
    ),
    "/guard_alarm": Topic("something came that is not believed", {"ignored": _text("what")}),
    "/guard_stalled": Topic("the guard itself was not let run", {"stalled_s": _number("s")}),
    # --- the world, at levels with a simulated one; frame w is ENU ---
    "/scene": Topic(
        "what does not change in the world; first",
        {
            "target_id": _whole("of the object that is the target"),
            "min_separation_m": _number("limit, m"),
            "kind": _text("of all objects: car, person or drone"),
            "boxes": _tables("parts of every object, in its own frame", c=_numbers("centre, m"), s=_numbers("size, m")),
            "clock_offset_ns": _table("clock of a role minus the world's, ns"),
            "cameras": _table("by role", sender=_table("", **_CAMERA), receiver=_table("", **_CAMERA)),
            "mounts": _table("by role", sender=_table("", **_MOUNT), receiver=_table("", **_MOUNT)),
        },
    ),
    "/truth": Topic(
        "where everything is, at 20 Hz or more; poses are bodies (FRD) in the world (ENU)",
        {
            role: _table("body", t=_numbers("m"), q=_numbers("wxyz"), in_air=_flag("not on the ground"))
            for role in ("sender", "receiver")
        }
        | {"objects": _tables("every object", id=_whole(""), t=_numbers("position, m"), yaw=_number("rad"))},
    ),
    "/autopilot": Topic(
        "what an autopilot does, when it changes",
        {"role": _text("whose"), "mode": _text("flight mode"), "armed": _flag("motors may turn")},
    ),
    "/fault": Topic("a fault was injected", {"fault": _text("its name, docs/faults.md")}),
    "/setpoint_gap": Topic(
        "longest time between two setpoints of a vehicle, at the end",
        {"role": _text("whose"), "gap_s": _number("s"), "last_ns": _whole("stamp of the last setpoint, ns")},
    ),
    "/violation": Topic("a safety monitor speaks", {"monitor": _text("its name"), "detail": _text("what was seen")}),
    # --- beacons ---
    "/beacons": Topic("how late beacons' positions are", {"latency_s": _number("s")}),
    "/serial": Topic(
        "bytes as they came",
        {
            "port": _text("where from"),
            "bytes": _text("in hexadecimal"),
        },
    ),
}


def schema_of(topic: str) -> bytes:
    """JSON Schema of a topic's records; of one that is not listed, anything."""
    listed = TOPICS.get(topic)
    schema: Schema = {"$schema": "https://json-schema.org/draft/2020-12/schema", "type": "object"}
    if listed is None:
        schema["properties"] = {}
    else:
        schema |= {"description": listed.text, "properties": listed.fields, "additionalProperties": False}
    return msgspec.json.encode(schema)


def blank(topic: str) -> dict[str, Any]:
    """A record of a topic in which nothing applies."""
    listed = TOPICS.get(topic)
    return {} if listed is None else dict.fromkeys(listed.fields)
