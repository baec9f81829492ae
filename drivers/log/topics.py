"""Every topic that PATH logs as JSON: its fields, with their units, and what one record of it is.

The one place they are told from: JSON Schemas in the logs, what a reader fills in, and
docs/logs.md. A field that does not apply is left out of a record and comes back as null. The
schemas use only what Foxglove's reader of them understands: one type a field, and no list of lists.
"""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import msgspec

from drivers.log.drone_topics import DRONE
from drivers.log.handover_topics import HANDOVER
from drivers.log.topic_fields import (
    CAMERA,
    MOUNT,
    Schema,
    Topic,
    flag,
    number,
    numbers,
    table,
    tables,
    text,
    whole,
)
from path.camera.model import CameraModel

_INTRINSICS = ("width", "height", "fx", "fy", "cx", "cy", "distortion")


def camera_record(camera: CameraModel) -> dict[str, Any]:
    """Intrinsics as they are logged, and what a calibration says beyond them."""
    record = {name: getattr(camera, name) for name in _INTRINSICS}
    record["doubts"] = [one for doubt in camera.doubts for one in doubt]
    return record if camera.thinning is None else {**record, "thinning": asdict(camera.thinning)}


TOPICS: dict[str, Topic] = {
    **DRONE,
    **HANDOVER,
    # --- guard ---
    "/guard": Topic(
        "a decision of the guard",
        {
            "stage": text("of the guard"),
            "act": text("what it does"),
            "reason": text("why"),
            "beat_age_s": number("since the script's last beat, s"),
            "mode": text("flight mode as heard"),
        },
    ),
    "/guard_view": Topic(
        "the vehicle as its guard sees it, twice a second",
        {
            "armed": flag("motors may turn"),
            "in_air": flag("as the vehicle says"),
            "mode": text("flight mode"),
            "position_n_m": numbers("north, east, down in m from the origin of the rig"),
            "battery": number("what is left, 0 to 1"),
            "script": text("what the script said it does"),
            "ignored": table("what came and was not believed: how often, by what it was"),
        },
    ),
    "/guard_alarm": Topic("something came that is not believed", {"ignored": text("what")}),
    "/guard_stalled": Topic("the guard itself was not let run", {"stalled_s": number("s")}),
    # --- the live page ---
    "/operator": Topic(
        "something was asked for on the live page",
        {
            "act": text("place, sight, choose or stop"),
            "done": flag("it was passed on; else it was refused"),
            "why": text("what was passed on, or why not"),
            "who": text("address of the page's computer"),
        },
    ),
    # --- the world, at levels with a simulated one; frame w is ENU ---
    "/scene": Topic(
        "what does not change in the world; first",
        {
            "target_id": whole("of the object that is the target"),
            "min_separation_m": number("limit, m"),
            "kind": text("of all objects: car, person or drone"),
            "boxes": tables(
                "parts of every object, in its own frame",
                c=numbers("centre, m"),
                s=numbers("size, m"),
            ),
            "clock_offset_ns": table("clock of a role minus the world's, ns"),
            "cameras": table("by role", sender=table("", **CAMERA), receiver=table("", **CAMERA)),
            "mounts": table("by role", sender=table("", **MOUNT), receiver=table("", **MOUNT)),
        },
    ),
    "/truth": Topic(
        "where everything is, at 20 Hz or more; poses are bodies (FRD) in the world (ENU)",
        {
            role: table("body", t=numbers("m"), q=numbers("wxyz"), in_air=flag("not on the ground"))
            for role in ("sender", "receiver")
        }
        | {
            "objects": tables(
                "every object",
                id=whole(""),
                t=numbers("position, m"),
                yaw=number("rad"),
            )
        },
    ),
    "/autopilot": Topic(
        "what an autopilot does, when it changes",
        {"role": text("whose"), "mode": text("flight mode"), "armed": flag("motors may turn")},
    ),
    "/fault": Topic("a fault was injected", {"fault": text("its name, docs/faults.md")}),
    "/setpoint_gap": Topic(
        "longest time between two setpoints of a vehicle, at the end",
        {
            "role": text("whose"),
            "gap_s": number("s"),
            "last_ns": whole("stamp of the last setpoint, ns"),
        },
    ),
    "/violation": Topic(
        "a safety monitor speaks", {"monitor": text("its name"), "detail": text("what was seen")}
    ),
    # --- beacons ---
    "/beacons": Topic("how late beacons' positions are", {"latency_s": number("s")}),
    "/serial": Topic(
        "bytes as they came",
        {
            "port": text("where from"),
            "bytes": text("in hexadecimal"),
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
        schema |= {
            "description": listed.text,
            "properties": listed.fields,
            "additionalProperties": False,
        }
    return msgspec.json.encode(schema)


def blank(topic: str) -> dict[str, Any]:
    """A record of a topic in which nothing applies."""
    listed = TOPICS.get(topic)
    return {} if listed is None else dict.fromkeys(listed.fields)
