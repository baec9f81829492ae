"""Colour and registered depth out of a bag of ROS 1 or 2, through ``rosbags`` (the extra ``ros``).

``path-handoff export`` reads them; what else of a bag there is, is left alone. Depth is taken only
where the bag says that it is of the colour camera: by its topic's name (``aligned_depth_to_color``,
``depth_registered`` …) or by a camera_info that equals colour's in frame and matrix. Depth of
another camera would have to be registered, and no bag says reliably where that camera was.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Iterator, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.recordings.ros_bag import ros_bag_at
from drivers.recordings.stamps import RecordingError
from drivers.rig.foreign_lens import ForeignError, ros_lens
from path.arrays import Array, Depths
from path.camera.lenses import StandIn, as_brown_conrady
from path.camera.model import CameraModel
from path.values import frozen

IMAGE = "sensor_msgs/msg/Image"
COMPRESSED = "sensor_msgs/msg/CompressedImage"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
INSTALL = "install the extra `ros`: docs/films.md says how"
REGISTERED = ("aligned_depth_to_color", "depth_registered", "depth_to_rgb", "depth_to_color")
COLORS: dict[str, tuple[int, int | None]] = {
    "bgr8": (3, None),
    "rgb8": (3, cv2.COLOR_RGB2BGR),
    "bgra8": (4, cv2.COLOR_BGRA2BGR),
    "rgba8": (4, cv2.COLOR_RGBA2BGR),
    "mono8": (1, cv2.COLOR_GRAY2BGR),
    "8UC3": (3, None),
    "yuv422": (2, cv2.COLOR_YUV2BGR_UYVY),
    "uyvy": (2, cv2.COLOR_YUV2BGR_UYVY),
    "yuv422_yuy2": (2, cv2.COLOR_YUV2BGR_YUY2),
    "yuyv": (2, cv2.COLOR_YUV2BGR_YUY2),
    "bayer_rggb8": (1, cv2.COLOR_BayerRGGB2BGR),
    "bayer_bggr8": (1, cv2.COLOR_BayerBGGR2BGR),
    "bayer_gbrg8": (1, cv2.COLOR_BayerGBRG2BGR),
    "bayer_grbg8": (1, cv2.COLOR_BayerGRBG2BGR),
}
NOT_COLOR = {"depth", "infra", "ir", "disparity", "mask", "label", "labels", "confidence"}
NOT_IMAGES = ("/theora", "/ffmpeg", "/h264", "/compressedDepth")  # as single images
DEPTHS = ("16UC1", "mono16", "32FC1")
REMEDY = "record colour (`.../color/image_raw`) and depth registered to it (RealSense: align_depth.enable:=true)"
FARTHEST_M = 65.0  # what 16 bits hold in millimetres
NS = 1_000_000_000


@frozen
class FilmFrame:
    """Colour (h, w, 3) BGR and depth (h, w) in mm of the colour camera's pixels, at ``stamp_ns`` of
    the bag's clock.
    """

    stamp_ns: int
    color: NDArray[np.uint8]
    depth_mm: Depths | None


class TornImage(RecordingError):
    """A compressed image that is not whole: it is no frame."""


class RosImages:
    """The images of a bag.

    Attributes:
        color_topic, depth_topic: which were taken; no depth: None.
        color_size: (width, height) in px.
        serial: of the camera, which a bag does not say.
        clock: whose the stamps are.
        torn: so many frames of ``frames`` were not whole, and are none.
    """

    serial = ""
    clock = "the clock of who recorded it"
    torn: int = 0

    def __init__(self, path: Path) -> None:
        """Raise RecordingError for a bag that cannot be read, or without colour and its depth."""
        self._path = path
        self._reader = _opened(path)
        try:
            images = [c for c in self._reader.connections if c.msgtype in (IMAGE, COMPRESSED)]
            topics = [c.topic for c in images]
            named = [topic for topic in topics if _is_color(topic)]
            self.color_topic = self._only(named or list(filter(_may_be_color, topics)), "colour")
            depths = [topic for topic in topics if "depth" in topic]
            self._color_info = self._info(self.color_topic)
            self.depth_topic = self._registered(depths) if depths else None
            first = self._first_whole(self.color_topic)
        except (ValueError, KeyError, RuntimeError, OSError) as error:
            raise self._damaged(error) from error
        self.color_size: tuple[int, int] = first.shape[1], first.shape[0]

    @property
    def has_depth(self) -> bool:
        return self.depth_topic is not None

    def factory_color(self) -> StandIn | None:
        """The colour camera by the bag's camera_info; None when there is none.

        Raises RecordingError for a lens of a kind that is not known, or that bends too much.
        """
        info = self._color_info
        if info is None:
            return None
        where = self.color_topic
        said = (int(info.width), int(info.height))
        if said != self.color_size:
            raise RecordingError(
                f"{where}: images of {self.color_size[0]}x{self.color_size[1]} px with a camera_info of "
                f"{said[0]}x{said[1]} px",
                "name a calibration",
            )
        matrix = _matrix(info, "k", 3)
        numbers = [float(k) for k in _of(info, "d")]
        model = str(info.distortion_model)
        if "rect" in self.color_topic:  # its lens was taken out of it
            matrix = _matrix(info, "p", 4)
            numbers = []
            model = "none"
        try:
            return as_brown_conrady(ros_lens(model, said, matrix, numbers))
        except (ForeignError, ValueError) as error:
            raise RecordingError(f"{where}: {error}", "name a calibration") from error

    def frames(self, color: CameraModel | None = None) -> Iterator[FilmFrame]:
        """Yield colour and depth that were taken together. Raises RecordingError where the bag is
        damaged. ``color`` is not asked: its depth is registered already.
        """
        del color
        try:
            colors = list(self._stamps(self.color_topic))
            back = sum(after <= before for before, after in pairwise(colors))
            if back:
                raise RecordingError(
                    f"{self._path}: of {len(colors)} images of {self.color_topic} {back} are stamped no "
                    "later than the one before (their header's stamp)",
                    "record again with the camera's stamps in the headers, from one start of it",
                )
            if self.depth_topic is None:
                yield from self._alone()
            else:
                partner = _partners(colors, sorted(self._stamps(self.depth_topic)))
                yield from self._paired(partner, self.depth_topic)
        except (ValueError, KeyError, RuntimeError, OSError) as error:
            raise self._damaged(error) from error
        finally:
            self._reader.close()

    def _alone(self) -> Iterator[FilmFrame]:
        """Yield colour of a bag that has no depth."""
        for _, message in self._messages(self.color_topic):
            try:
                pixels = _bgr(message)
            except TornImage:
                self.torn += 1
                continue
            self._check_size(pixels)
            yield FilmFrame(_stamp_of(message), pixels, None)

    def _check_size(self, pixels: NDArray[np.uint8]) -> None:
        size = (pixels.shape[1], pixels.shape[0])
        if size != self.color_size:
            raise RecordingError(
                f"{self._path}: {self.color_topic} has images of {size[0]}x{size[1]} px after such of "
                f"{self.color_size[0]}x{self.color_size[1]} px",
                "copy the images of one size into a bag of their own",
            )

    def _paired(self, partner: Mapping[int, int], depth_topic: str) -> Iterator[FilmFrame]:
        """Yield pairs, by colour's stamp and its depth's. Depth often comes some messages after its
        colour.
        """
        wanted = {depth_ns: color_ns for color_ns, depth_ns in partner.items()}
        waiting: dict[int, dict[str, Any]] = {}
        topics = (self.color_topic, depth_topic)
        for topic, message in self._messages(*topics):
            stamp_ns = _stamp_of(message)
            color_ns = stamp_ns if topic == self.color_topic else wanted.get(stamp_ns)
            if color_ns is None or color_ns not in partner:
                continue
            both = waiting.setdefault(color_ns, {})
            both[topic] = message
            if len(both) < 2:
                continue
            del waiting[color_ns]
            color, depth = (both[each] for each in topics)
            try:
                pixels = _bgr(color)
                depth_mm = _millimetres(depth)
            except TornImage:
                self.torn += 1
                continue
            self._check_size(pixels)
            if pixels.shape[:2] != depth_mm.shape:
                raise RecordingError(
                    f"{self._path}: depth of {depth_mm.shape[1]}x{depth_mm.shape[0]} px for colour of "
                    f"{pixels.shape[1]}x{pixels.shape[0]} px: it is not registered",
                    REMEDY,
                )
            yield FilmFrame(color_ns, pixels, depth_mm)

    def _messages(self, *topics: str) -> Iterator[tuple[str, Any]]:
        connections = [c for c in self._reader.connections if c.topic in topics]
        for connection, _, raw in self._reader.messages(connections):
            yield connection.topic, self._reader.deserialize(raw, connection.msgtype)

    def _stamps(self, topic: str) -> Iterator[int]:
        for _, message in self._messages(topic):
            yield _stamp_of(message)

    def _first_whole(self, topic: str) -> NDArray[np.uint8]:
        """Return the first image that is whole. Raises RecordingError."""
        torn: TornImage | None = None
        for _, message in self._messages(topic):
            try:
                return _bgr(message)
            except TornImage as error:
                torn = error
        raise torn or RecordingError(f"{self._path}: nothing was recorded of {topic}", REMEDY)

    def _info(self, topic: str) -> Any | None:
        """The first camera_info beside a topic."""
        beside = (
            topic.removesuffix("/compressed").removesuffix("/compressedDepth").rpartition("/")[0]
        )
        named = f"{beside}/camera_info"
        return (
            next((message for _, message in self._messages(named)), None)
            if self._has(named)
            else None
        )

    def _has(self, topic: str) -> bool:
        return any(c.topic == topic and c.msgtype == CAMERA_INFO for c in self._reader.connections)

    def _only(self, topics: list[str], what: str) -> str:
        """Return the one topic, or the one of several forms of it. Raises RecordingError."""
        found = sorted(
            set(topics),
            key=lambda topic: ("compressed" in topic, "rect" in topic, len(topic), topic),
        )
        if not found:
            listed = ", ".join(sorted({c.topic for c in self._reader.connections})) or "nothing"
            raise RecordingError(f"{self._path} has no {what} to be read; it has: {listed}", REMEDY)
        others = [topic for topic in found if _stem(topic) != _stem(found[0])]
        if others:
            raise RecordingError(
                f"{self._path} has {what} of several cameras: {', '.join(found)}",
                "copy one camera's topics into a bag of their own (rosbags-convert --include-topic)",
            )
        return found[0]

    def _registered(self, topics: list[str]) -> str:
        """Return the topic of depth of colour's pixels. Raises RecordingError when there is
        none.
        """
        named = [topic for topic in topics if any(word in topic for word in REGISTERED)]
        alike = [topic for topic in topics if topic not in named and self._is_alike(topic)]
        if topics and not named and not alike:
            raise RecordingError(
                f"{self._path}: {', '.join(sorted(set(topics)))} is of the depth camera's own pixels, and the bag does "
                "not say where that camera is",
                REMEDY,
            )
        return self._only(named or alike, "depth")

    def _is_alike(self, topic: str) -> bool:
        """Return whether depth says that it is of colour's pixels: the same frame, size and
        matrix.
        """
        own = self._info(topic)
        color = self._color_info
        if own is None or color is None or own.header.frame_id != color.header.frame_id:
            return False
        same_size = (own.width, own.height) == (color.width, color.height)
        return same_size and bool(np.allclose(_matrix(own, "k", 3), _matrix(color, "k", 3)))

    def _damaged(self, error: Exception) -> RecordingError:
        if isinstance(error, RecordingError):
            return error
        return RecordingError(
            f"{self._path}: the bag is damaged: {error}", "is it whole, and was it closed?"
        )


def _opened(path: Path) -> Any:
    """Return an open reader. Raises RecordingError, also when ``rosbags`` is not installed."""
    try:
        highlevel = importlib.import_module("rosbags.highlevel")
        typesys = importlib.import_module("rosbags.typesys")
    except ImportError as error:
        bag = ros_bag_at(path)
        what = bag.text if bag is not None else "a bag of ROS"
        raise RecordingError(
            f"{path} is {what}, not a recording of librealsense or of PATH", INSTALL
        ) from error
    kind = typesys.Stores.ROS1_NOETIC if path.suffix == ".bag" else typesys.Stores.ROS2_HUMBLE
    try:
        reader = highlevel.AnyReader([path], default_typestore=typesys.get_typestore(kind))
        reader.open()
    except Exception as error:  # of storage plug-ins, which share no base
        raise RecordingError(
            f"{path}: the bag cannot be read: {error}",
            "is it whole, and was it closed? `rosbag reindex` mends a .bag, `ros2 bag reindex` a "
            "folder, `mcap recover` a .mcap",
        ) from error
    return reader


def _of(info: Any, name: str) -> Array:
    """Return a field of a camera_info: ROS 2 writes it small, ROS 1 large."""
    return np.asarray(getattr(info, name, getattr(info, name.upper(), ())), np.float64)


def _matrix(info: Any, name: str, columns: int) -> Array:
    return _of(info, name).reshape(3, columns)


def _is_color(topic: str) -> bool:
    named = "color" in topic or "rgb" in topic
    return named and "depth" not in topic and not topic.endswith(NOT_IMAGES)


def _may_be_color(topic: str) -> bool:
    """Return whether a topic that does not say so may be colour: of a camera alone, or a webcam."""
    words = set(re.split(r"[/_]|(?<=[a-z])(?=\d)", topic.lower()))
    return not words & NOT_COLOR and not topic.endswith(NOT_IMAGES)


def _stem(topic: str) -> str:
    """Return the camera of a topic: raw and rectified, compressed and not, are of one."""
    return topic.removesuffix("/compressed").removesuffix("/compressedDepth").rpartition("/")[0]


def _stamp_of(message: Any) -> int:
    stamp = message.header.stamp
    return int(stamp.sec) * NS + int(stamp.nanosec)


def _partners(colors: list[int], depths: list[int]) -> dict[int, int]:
    """Return for colour's stamps the depth's nearest one, within half of colour's usual period;
    each at most once.
    """
    steps = [after - before for before, after in pairwise(colors) if after > before]
    tolerance_ns = int(np.median(steps)) // 2 if steps else NS // 60
    found: dict[int, int] = {}
    taken: set[int] = set()
    places = np.searchsorted(np.array(depths, np.int64), np.array(colors, np.int64))
    for stamp_ns, place in zip(colors, places.tolist(), strict=True):
        near = [
            depth_ns for depth_ns in depths[max(place - 1, 0) : place + 1] if depth_ns not in taken
        ]
        best = min(near, key=lambda each: abs(each - stamp_ns), default=None)
        if best is not None and abs(best - stamp_ns) <= tolerance_ns:
            found[stamp_ns] = best
            taken.add(best)
    return found


def _bgr(message: Any) -> NDArray[np.uint8]:
    if not hasattr(message, "encoding"):
        return _decompressed(message, cv2.IMREAD_COLOR, np.uint8)
    encoding = str(message.encoding)
    if encoding not in COLORS:
        raise RecordingError(
            f"colour is encoded as {encoding}",
            f"one of {', '.join(COLORS)}, or compressed, is read",
        )
    channels, conversion = COLORS[encoding]
    pixels = _rows(message, np.dtype(np.uint8), channels)
    return np.asarray(pixels if conversion is None else cv2.cvtColor(pixels, conversion), np.uint8)


def _millimetres(message: Any) -> Depths:
    """Return depth in mm: of REP 118, metres as float32 or millimetres as uint16."""
    if not hasattr(message, "encoding"):
        form = str(message.format)
        if not form.startswith("16UC1") or "rvl" in form:
            raise RecordingError(
                f"depth is compressed as {form}", "16UC1 in millimetres, as PNG, is read"
            )
        return _decompressed(message, cv2.IMREAD_UNCHANGED, np.uint16)
    encoding = str(message.encoding)
    if encoding not in DEPTHS:
        raise RecordingError(
            f"depth is encoded as {encoding}", f"one of {', '.join(DEPTHS)} is read"
        )
    if encoding == "32FC1":
        metres = _rows(message, np.dtype(np.float32), 1)
        with np.errstate(invalid="ignore"):
            given = np.isfinite(metres) & (metres > 0.0)
            believed = given & (metres < FARTHEST_M)
        if np.count_nonzero(believed) * 2 < np.count_nonzero(given):
            raise RecordingError(
                f"depth in 32FC1 is {np.median(metres[given]):.0f} at half of its pixels: these are no metres",
                "ROS has metres in 32FC1 and millimetres in 16UC1 (REP 118): convert it",
            )
        return np.where(believed, np.round(np.where(believed, metres, 0.0) * 1000.0), 0.0).astype(
            np.uint16
        )
    return np.ascontiguousarray(_rows(message, np.dtype(np.uint16), 1))


def _rows(message: Any, kind: np.dtype[Any], channels: int) -> NDArray[Any]:
    """Return pixels (h, w) or (h, w, channels), whatever the order of bytes and what follows each
    row.
    """
    height = int(message.height)
    width = int(message.width)
    step = int(message.step)
    wanted = width * channels * kind.itemsize
    data = np.asarray(message.data, np.uint8)
    if height < 1 or width < 1 or step < wanted or data.size < height * step:
        raise RecordingError(
            f"an image of {width}x{height} px as {message.encoding} has {data.size} bytes, {step} a row",
            "is the bag whole?",
        )
    rows = np.ascontiguousarray(data[: height * step].reshape(height, step)[:, :wanted])
    order = kind.newbyteorder(">" if message.is_bigendian else "<")
    pixels = rows.view(order).astype(kind)
    return pixels if channels == 1 else pixels.reshape(height, width, channels)


def _decompressed(message: Any, flags: int, kind: type[Any]) -> NDArray[Any]:
    data = np.asarray(message.data, np.uint8)
    begins = bytes(data[:64]).find(b"\x89PNG")  # compressed depth has a header of its own before it
    pixels = cv2.imdecode(data[max(begins, 0) :], flags) if data.size else None
    if pixels is None or pixels.dtype != kind:
        raise TornImage(
            f"an image compressed as {message.format} cannot be read", "is the bag whole?"
        )
    return pixels
