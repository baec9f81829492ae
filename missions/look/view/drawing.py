"""A log's messages as Rerun draws them: Foxglove's by their own schemas, and figures of PATH's
records.

Frames keep their names. Of the drone NAME:

    tf/FRAME                where a frame is in the one above it
    NAME/3d/...             what is drawn in the scene, each in its frame
    NAME/image, /boxes, /words   the image in its frustum, what is drawn over it, and the words to it
    plots/WHAT/NAME/...     figures over time
    NAME/log                phases, reasons, decisions

Whatever is not known here is left out. Imports Rerun: ``missions.look.view.command`` looks first
whether it is there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import msgspec
import numpy as np
import rerun as rr
from mcap.records import Schema
from mcap_protobuf.decoder import DecoderFactory

from drivers.log.topics import blank
from missions.look.view.figures import PlottedValues
from path.arrays import Array
from path.geometry.rotation import R_from_quat
from path.messages import Vec3

UTC = "utc"
RUN = "run"
OF_AN_ATTEMPT = ("overlap", "count", "evidence")
"""Plots that an attempt has, and nothing between two of them: no line joins its end to the next
one's begin.
"""
GAP_NS = 500_000_000
"""After so long without a pair the line ends where the last one was."""
# of foxglove.PointsAnnotation; LinePrimitive has 1 and 2
_LINE_LOOP = 2
_LINE_LIST = 4
_LEVELS = {1: "DEBUG", 2: "INFO", 3: "WARN", 4: "ERROR", 5: "CRITICAL"}


class Drawing:
    """Draws one log, or one flight as it goes, into a recording.

    Attributes:
        paths: where each drone was so far, in the world's frame, by its name.
    """

    def __init__(self, recording: rr.RecordingStream) -> None:
        self._recording = recording
        self._decode: dict[str, Callable[[bytes], Any] | None] = {}
        self._begin_ns: int | None = None
        self._figures: dict[str, PlottedValues] = {}
        self._framed: set[str] = set()
        self._images: dict[str, tuple[int, int]] = {}
        self._newest_boxes: dict[str, Any] = {}
        self._plots: set[str] = set()
        self._open_ns: dict[str, int] = {}  # of each line of an attempt: when its newest point was
        self._R_world_n: Array | None = None
        self.paths: dict[str, list[Vec3]] = {}
        self._draw: dict[str, Callable[[str, Any], None]] = {
            "foxglove.FrameTransforms": self._transforms,
            "foxglove.CameraCalibration": self._calibration,
            "foxglove.CompressedImage": self._image,
            "foxglove.ImageAnnotations": self._over_the_image,
            "foxglove.SceneUpdate": self._scene,
            "foxglove.LocationFix": self._place,
            "foxglove.Log": self._words,
        }

    @property
    def plots(self) -> list[str]:
        """The kinds of plots that have something to show."""
        return sorted(self._plots)

    def message(
        self,
        topic: str,
        schema: Schema,
        utc_ns: int,
        data: bytes,
    ) -> None:
        """One message of a merged log, whose topics begin with the drone's name."""
        name, _, own = topic.lstrip("/").partition("/")
        draw = self._draw.get(schema.name)
        if draw is None and not schema.name.startswith("path."):
            return
        self._at(utc_ns)
        if draw is not None:
            decode = self._decoder(schema)
            if decode is not None:
                draw(name, decode(data))
            return
        record = {**blank(f"/{own}"), **msgspec.json.decode(data)}
        if own == "commit":
            self._end_lines(name, utc_ns)
        for path, value in self._figures.setdefault(name, PlottedValues()).of(
            f"/{own}",
            utc_ns,
            record,
        ):
            self._plot(name, path, utc_ns, value)

    def _end_lines(self, name: str, utc_ns: int) -> None:
        """End the lines of a drone's attempt: what its gate says of the next one has nothing to do
        with them.
        """
        for whole in [whole for whole in self._open_ns if whole.split("/")[2] == name]:
            self._end_line(whole, max(utc_ns, self._open_ns[whole] + 1))
        self._at(utc_ns)

    def _end_line(self, whole: str, utc_ns: int) -> None:
        del self._open_ns[whole]
        self._at(utc_ns)
        self._log(whole, rr.Clear(recursive=False))

    def _plot(
        self,
        name: str,
        path: str,
        utc_ns: int,
        value: float,
    ) -> None:
        kind, _, what = path.partition("/")
        whole = f"plots/{kind}/{name}/{what}"
        if kind in OF_AN_ATTEMPT:
            newest_ns = self._open_ns.get(whole, utc_ns)
            if utc_ns - newest_ns > GAP_NS:
                self._end_line(whole, newest_ns + 1)
                self._at(utc_ns)
            self._open_ns[whole] = utc_ns
        if whole not in self._framed:
            self._framed.add(whole)
            self._plots.add(kind)
            self._log(whole, rr.SeriesLines(names=f"{name} {what.replace('_', ' ')}"), static=True)
        self._log(whole, rr.Scalars(value))

    def _at(self, utc_ns: int) -> None:
        self._begin_ns = utc_ns if self._begin_ns is None else self._begin_ns
        self._recording.set_time(UTC, timestamp=np.datetime64(utc_ns, "ns"))
        self._recording.set_time(RUN, duration=np.timedelta64(utc_ns - self._begin_ns, "ns"))

    def _decoder(self, schema: Schema) -> Callable[[bytes], Any] | None:
        if schema.name not in self._decode:
            # A factory remembers schemas by their id, which a stream and a second log give to
            # others again.
            self._decode[schema.name] = DecoderFactory().decoder_for("protobuf", schema)
        return self._decode[schema.name]

    def _log(self, path: str, *parts: Any, frame: str = "", static: bool = False) -> None:
        if frame and path not in self._framed:
            self._framed.add(path)
            self._recording.log(path, rr.CoordinateFrame(frame), static=True)
        self._recording.log(path, *parts, static=static)

    # --- where things are

    def _transforms(self, name: str, message: Any) -> None:
        for each in message.transforms:
            t = each.translation
            q = each.rotation
            if (each.parent_frame_id, each.child_frame_id) == ("world", "n"):
                self._R_world_n = R_from_quat((q.w, q.x, q.y, q.z))
            elif each.child_frame_id == f"{name}/body" and self._R_world_n is not None:
                x, y, z = (self._R_world_n @ _xyz(t)).tolist()
                self.paths.setdefault(name, []).append((x, y, z))
            transform = rr.Transform3D(
                translation=(t.x, t.y, t.z), quaternion=rr.Quaternion(xyzw=(q.x, q.y, q.z, q.w)),
                parent_frame=each.parent_frame_id, child_frame=each.child_frame_id,
            )  # fmt: skip
            # of "n" every drone tells, and it is one
            self._log(f"tf/{each.child_frame_id}", transform)

    def _calibration(self, name: str, message: Any) -> None:
        pinhole = rr.Pinhole(
            image_from_camera=np.reshape(message.K, (3, 3)), resolution=(message.width, message.height),
            image_plane_distance=0.4, parent_frame=message.frame_id, child_frame=_image_frame(name),
        )  # fmt: skip
        self._log(f"{name}/pinhole", pinhole, static=True)

    def _scene(self, name: str, message: Any) -> None:
        for entity in message.entities:
            path = f"{name}/3d/{entity.id.rpartition('/')[2]}"
            log = partial(self._log, frame=entity.frame_id)
            if entity.cubes:
                log(f"{path}/boxes", _boxes(entity.cubes))
            if entity.spheres:
                log(f"{path}/ellipsoids", _ellipsoids(entity.spheres))
            if entity.lines:
                log(f"{path}/lines", _strips(entity.lines))
            if entity.texts:
                places = [_xyz(each.pose.position) for each in entity.texts]
                labels = [each.text for each in entity.texts]
                colors = [_rgba(each.color) for each in entity.texts]
                log(f"{path}/texts", rr.Points3D(places, labels=labels, colors=colors, radii=0.005))

    def _place(self, name: str, message: Any) -> None:
        self._log(f"{name}/position", rr.GeoPoints(lat_lon=[(message.latitude, message.longitude)]))

    # --- images

    def _image(self, name: str, message: Any) -> None:
        image = rr.EncodedImage(contents=message.data, media_type=f"image/{message.format}")
        self._log(f"{name}/image", image, frame=_image_frame(name))
        self._images[name] = _stamp(message)
        boxes = self._newest_boxes.pop(name, None)
        if boxes is not None and _stamp(boxes) == self._images[name]:
            self._annotations(name, boxes)

    def _over_the_image(self, name: str, message: Any) -> None:
        """Boxes are told more often than images: only those of the image's own instant belong over
        it.
        """
        image = self._images.get(name)
        if image is None or image == _stamp(message):
            self._annotations(name, message)
        else:
            self._newest_boxes[name] = message

    def _annotations(self, name: str, message: Any) -> None:
        strips: list[list[tuple[float, float]]] = []
        colors: list[tuple[int, ...]] = []
        for each in message.points:
            points = [(p.x, p.y) for p in each.points]
            parts = _pieces(points, each.type == _LINE_LOOP, each.type == _LINE_LIST)
            strips += parts
            colors += [_rgba(each.outline_color)] * len(parts)
        frame = _image_frame(name)
        self._log(
            f"{name}/boxes",
            rr.LineStrips2D(strips, colors=colors, radii=-1.5, draw_order=20.0),
            frame=frame,
        )
        words = " · ".join(each.text for each in message.texts)
        self._log(f"{name}/words", rr.TextLog(words, level=rr.TextLogLevel.DEBUG))
        places = [(each.position.x, each.position.y) for each in message.texts]
        labels = rr.Points2D(
            places,
            labels=[each.text for each in message.texts],
            colors=[_rgba(each.text_color) for each in message.texts],
            radii=0.5,
            show_labels=True,
            draw_order=30.0,
        )
        self._log(f"{name}/verdict", labels, frame=frame)

    # --- words

    def _words(self, name: str, message: Any) -> None:
        self._log(
            f"{name}/log", rr.TextLog(message.message, level=_LEVELS.get(message.level, "INFO"))
        )


def _stamp(message: Any) -> tuple[int, int]:
    return message.timestamp.seconds, message.timestamp.nanos


def _image_frame(name: str) -> str:
    return f"{name}/image"


def _boxes(cubes: Sequence[Any]) -> rr.Boxes3D:
    return rr.Boxes3D(
        centers=[_xyz(each.pose.position) for each in cubes],
        sizes=[_xyz(each.size) for each in cubes],
        quaternions=[rr.Quaternion(xyzw=_xyzw(each.pose.orientation)) for each in cubes],
        colors=[_rgba(each.color) for each in cubes],
        fill_mode="solid",
    )


def _ellipsoids(spheres: Sequence[Any]) -> rr.Ellipsoids3D:
    return rr.Ellipsoids3D(
        centers=[_xyz(each.pose.position) for each in spheres],
        half_sizes=[[half / 2 for half in _xyz(each.size)] for each in spheres],
        quaternions=[rr.Quaternion(xyzw=_xyzw(each.pose.orientation)) for each in spheres],
        colors=[_rgba(each.color) for each in spheres],
    )


def _strips(lines: Sequence[Any]) -> rr.LineStrips3D:
    strips: list[list[tuple[float, ...]]] = []
    colors: list[tuple[int, ...]] = []
    radii: list[float] = []
    for each in lines:
        parts = _pieces([_xyz(p) for p in each.points], each.type == 1, each.type == 2)
        strips += parts
        colors += [_rgba(each.color)] * len(parts)
        radii += [each.thickness / 2] * len(parts)
    return rr.LineStrips3D(strips, colors=colors, radii=radii)


def _pieces(
    points: list[Any],
    loop: bool,
    pairs: bool,
) -> list[list[Any]]:
    if pairs:
        return [points[k : k + 2] for k in range(0, len(points), 2)]
    return [[*points, points[0]]] if loop and points else [points]


def _xyz(vector: Any) -> tuple[float, ...]:
    return vector.x, vector.y, vector.z


def _xyzw(q: Any) -> tuple[float, ...]:
    return q.x, q.y, q.z, q.w


def _rgba(color: Any) -> tuple[int, ...]:
    return tuple(round(255 * value) for value in (color.r, color.g, color.b, color.a))
