"""Foxglove's primitives from PATH's numbers: images, poses and transforms, lines, boxes and
texts.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from foxglove import Schema
from foxglove.messages import (
    Color,
    CompressedImage,
    CompressedVideo,
    FrameTransform,
    LinePrimitive,
    LinePrimitiveLineType,
    LocationFix,
    Point2,
    Point3,
    PointsAnnotation,
    PointsAnnotationType,
    Pose,
    Quaternion,
    RawImage,
    SpherePrimitive,
    TextAnnotation,
    Timestamp,
    Vector3,
)

from path.arrays import Depths
from path.geometry.rotation import quat_from_R

Record = Mapping[str, Any]


class Message(Protocol):
    """A message of Foxglove's."""

    def encode(self) -> bytes: ...

    @staticmethod
    def get_schema() -> Schema: ...


EARTH_M = 6_378_137.0
SIGMAS = 3.0  # radius of the target's sphere
FRUSTUM_M = 0.4
FENCE_POINTS = 72
FONT_PX = 14.0

BLUE = Color(r=0.2, g=0.6, b=1.0, a=1.0)
ORANGE = Color(r=1.0, g=0.6, b=0.1, a=1.0)
GREEN = Color(g=0.9, b=0.3, a=1.0)
PALE_BLUE = Color(r=0.2, g=0.6, b=1.0, a=0.5)
PALE_ORANGE = Color(r=1.0, g=0.6, b=0.1, a=0.5)
PINK = Color(r=1.0, g=0.3, b=0.8, a=1.0)
GREY = Color(r=0.6, g=0.6, b=0.6, a=0.8)
RED = Color(r=1.0, a=1.0)
GHOST = Color(r=0.3, g=0.9, b=0.3, a=0.35)
BACK = Color(a=0.6)

AS_IT_IS = (1.0, 0.0, 0.0, 0.0)
VIDEO = CompressedVideo.get_schema()
RAW = RawImage.get_schema()


def compressed_image(
    stamp_ns: int,
    frame: str,
    jpeg: bytes,
) -> Message:
    return CompressedImage(timestamp=time_of(stamp_ns), frame_id=frame, data=jpeg, format="jpeg")


def compressed_video(
    stamp_ns: int,
    frame: str,
    h264: bytes,
) -> Message:
    return CompressedVideo(timestamp=time_of(stamp_ns), frame_id=frame, data=h264, format="h264")


def depth_image(
    stamp_ns: int,
    frame: str,
    depth_mm: Depths,
) -> Message:
    height, width = depth_mm.shape
    return RawImage(
        timestamp=time_of(stamp_ns),
        frame_id=frame,
        width=width,
        height=height,
        encoding="16UC1",
        step=2 * width,
        data=depth_mm.astype("<u2", copy=False).tobytes(),
    )


def time_of(stamp_ns: int) -> Timestamp:
    return Timestamp(sec=stamp_ns // 1_000_000_000, nsec=stamp_ns % 1_000_000_000)


def pose(t: Sequence[float], q: Sequence[float]) -> Pose:
    return Pose(position=vector(t), orientation=quaternion(q))


def vector(t: Sequence[float]) -> Vector3:
    return Vector3(x=t[0], y=t[1], z=t[2])


def quaternion(q: Sequence[float]) -> Quaternion:
    return Quaternion(w=q[0], x=q[1], y=q[2], z=q[3])


def point(p: Sequence[float]) -> Point3:
    return Point3(x=p[0], y=p[1], z=p[2])


def moved(
    stamp_ns: int,
    parent: str,
    child: str,
    t: Sequence[float],
    q: Sequence[float],
) -> FrameTransform:
    return FrameTransform(
        timestamp=time_of(stamp_ns), parent_frame_id=parent, child_frame_id=child, translation=vector(t),
        rotation=quaternion(q),
    )  # fmt: skip


def transform(
    stamp_ns: int,
    parent: str,
    child: str,
    rows: Sequence[float],
) -> FrameTransform:
    """``rows``: the upper three of a pose's matrix, one after another."""
    matrix = np.reshape(rows, (3, 4))
    return moved(stamp_ns, parent, child, matrix[:, 3].tolist(), quat_from_R(matrix[:, :3]))


def fix(
    stamp_ns: int,
    origin: Sequence[float],
    position_n_m: Sequence[float],
) -> Message:
    """Return the position on a sphere of the earth's size: for a map, over a field."""
    latitude_deg, longitude_deg, altitude_m = origin
    north, east, down = position_n_m
    return LocationFix(
        timestamp=time_of(stamp_ns),
        frame_id="n",
        latitude=latitude_deg + math.degrees(north / EARTH_M),
        longitude=longitude_deg
        + math.degrees(east / (EARTH_M * math.cos(math.radians(latitude_deg)))),
        altitude=altitude_m - down,
    )


def frustum(camera: Record, color: Color) -> LinePrimitive:
    """The frustum of the camera, without distortion."""
    edges = [
        (
            (u - camera["cx"]) / camera["fx"] * FRUSTUM_M,
            (v - camera["cy"]) / camera["fy"] * FRUSTUM_M,
            FRUSTUM_M,
        )
        for u, v in (
            (0, 0),
            (camera["width"], 0),
            (camera["width"], camera["height"]),
            (0, camera["height"]),
        )
    ]
    points: list[Point3] = []
    for k, edge in enumerate(edges):
        points += [Point3(), point(edge), point(edge), point(edges[(k + 1) % 4])]
    return LinePrimitive(
        type=LinePrimitiveLineType.LineList,
        points=points,
        color=color,
        thickness=0.01,
    )


def fence(radius_m: float, height_m: float) -> list[LinePrimitive]:
    """A circle on the ground and one at its height, around the origin."""
    turns = np.linspace(0.0, 2.0 * math.pi, FENCE_POINTS, endpoint=False).tolist()
    return [
        LinePrimitive(
            type=LinePrimitiveLineType.LineLoop,
            points=[
                Point3(x=radius_m * math.cos(a), y=radius_m * math.sin(a), z=-up_m) for a in turns
            ],
            color=RED,
            thickness=0.02,
        )
        for up_m in (0.0, height_m)
    ]


def sphere(
    point: Sequence[float],
    sigma_m: float,
    color: Color,
) -> SpherePrimitive:
    size = 2.0 * SIGMAS * sigma_m
    return SpherePrimitive(
        pose=pose(point, AS_IT_IS),
        size=Vector3(x=size, y=size, z=size),
        color=color,
    )


def box(
    stamp_ns: int,
    box: Sequence[float] | None,
    color: Color,
) -> list[PointsAnnotation]:
    if box is None:
        return []
    x, y, w, h = box
    corners = [(x, y), (x + w, y), (x + w, y + h), (x, y + h)]
    return [lines(stamp_ns, PointsAnnotationType.LineLoop, corners, color)]


def lines(
    stamp_ns: int,
    kind: PointsAnnotationType,
    points: Sequence[Sequence[float]],
    color: Color,
) -> PointsAnnotation:
    return PointsAnnotation(
        timestamp=time_of(stamp_ns), type=kind, points=[Point2(x=u, y=v) for u, v in points], outline_color=color,
        thickness=2.0,
    )  # fmt: skip


def text(
    stamp_ns: int,
    text: str,
    color: Color,
    line: int = 0,
) -> TextAnnotation:
    position = Point2(x=6.0, y=FONT_PX + 6.0 + line * (FONT_PX + 6.0))
    return TextAnnotation(
        timestamp=time_of(stamp_ns), position=position, text=text, font_size=FONT_PX, text_color=color,
        background_color=BACK,
    )  # fmt: skip
