"""The parts that topics are made of: fields with their units, and groups of fields that several
topics share.
"""

from __future__ import annotations

from typing import Any

from path.values import frozen

Schema = dict[str, Any]


@frozen
class Topic:
    """The meaning of one topic's records, and their fields as JSON Schemas."""

    text: str
    fields: dict[str, Schema]


def field(kind: str, meaning: str, **more: Any) -> Schema:
    return {"type": kind, "description": meaning, **more}


def number(meaning: str) -> Schema:
    return field("number", meaning)


def whole(meaning: str) -> Schema:
    return field("integer", meaning)


def text(meaning: str) -> Schema:
    return field("string", meaning)


def flag(meaning: str) -> Schema:
    return field("boolean", meaning)


def numbers(meaning: str) -> Schema:
    return field("array", meaning, items={"type": "number"})


def table(meaning: str, **fields: Schema) -> Schema:
    """A nested record; without fields: names that are not known beforehand."""
    return field("object", meaning, properties=fields)


def tables(meaning: str, **fields: Schema) -> Schema:
    return field("array", meaning, items={"type": "object", "properties": fields})


def box(meaning: str) -> Schema:
    return numbers(f"[x, y, w, h] in px, x and y the top left corner: {meaning}")


def reason(meaning: str) -> Schema:
    return text(f"why not, of path.observations.MissReason: {meaning}")


def pose(meaning: str) -> Schema:
    return table(meaning, t=numbers("position in m"), q=numbers("rotation, quaternion wxyz"))


CAPTURE = whole("capture of the frame, ns of this log's own clock")
CAMERA = {
    "width": whole("px"),
    "height": whole("px"),
    "fx": number("focal length, px"),
    "fy": number("focal length, px"),
    "cx": number("principal point, px"),
    "cy": number("principal point, px"),
    "distortion": numbers("Brown-Conrady, OpenCV's order"),
    "doubts": numbers(
        "by how much fx, fy, cx, cy, k1, k2, p1, p2, k3 are off together: nine for each cause"
    ),
    "thinning": table(
        "how the camera leaves out pixels",
        kept=whole("pixels of the image ..."),
        of=whole("... for so many of the sensor"),
        begins=numbers("where the pattern begins, column and row, px"),
    ),
}
ATTEMPT = {
    "handoff_id": whole("of the mission"),
    "epoch": whole("of the attempt; it only grows"),
    "target_id": whole("of the target"),
}
MOUNT = {
    "T_b_c": pose("camera to the body (FRD) of its drone"),
    "T_b_v": pose("marker frame to the body (FRD) of the sender"),
}
