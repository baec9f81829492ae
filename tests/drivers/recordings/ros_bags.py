"""Bags of ROS 1 and 2 with the images of one camera, as ``rosbags`` writes them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

Form = Literal["ros1", "db3", "mcap"]
FORMS: tuple[Form, ...] = ("ros1", "db3", "mcap")
WIDTH, HEIGHT, FRAMES = 24, 16, 6
BEGIN_NS, STEP_NS = 1_790_000_000 * 10**9, 33_000_000
DEPTH_MM = 1500
COLOR_BGR = (200, 120, 40)
ALIGNED, RAW = "/camera/aligned_depth_to_color/image_raw", "/camera/depth/image_rect_raw"
ORDERS = {"bgr8": (0, 1, 2), "rgb8": (2, 1, 0), "bgra8": (0, 1, 2, 3), "rgba8": (2, 1, 0, 3)}


@dataclass(frozen=True, slots=True)
class BagKind:
    """What is in a bag. ``model``: of the lens; None: no camera_info. ``late_ns``: depth's stamps
    after colour's; ``step_ns``: between colour's. ``unit_m``: of depth in 32FC1. ``torn``: images
    that are not whole.
    """

    color: str = "rgb8"
    depth: str = "16UC1"
    depth_topic: str | None = ALIGNED
    color_topic: str = "/camera/color/image_raw"
    model: str | None = "plumb_bob"
    coefficients: tuple[float, ...] = (-0.05, 0.06, 0.0003, 0.0007, -0.02)
    late_ns: int = 0
    padding: int = 0
    big_endian: bool = False
    depth_height: int = HEIGHT
    depth_focal_px: float = 30.0
    step_ns: int = STEP_NS
    unit_m: float = 0.001
    info_width: int = WIDTH
    torn: tuple[int, ...] = ()


def written(folder: Path, form: Form, kind: BagKind) -> Path:
    """Write a bag; its file is returned."""
    store = get_typestore(Stores.ROS1_NOETIC if form == "ros1" else Stores.ROS2_HUMBLE)
    if form == "ros1":
        writer: Any = Writer1(folder / "bag.bag")
    else:
        plugin = StoragePlugin.MCAP if form == "mcap" else StoragePlugin.SQLITE3
        writer = Writer2(folder / "bag", version=8, storage_plugin=plugin)
    serialize = store.serialize_ros1 if form == "ros1" else store.serialize_cdr
    connections: dict[str, Any] = {}
    with writer as bag:
        for topic, stamp_ns, message in _messages(store, form, kind):
            if topic not in connections:
                connections[topic] = bag.add_connection(topic, message.__msgtype__, typestore=store)
            bag.write(connections[topic], stamp_ns, serialize(message, message.__msgtype__))
    return folder / "bag.bag" if form == "ros1" else folder / "bag" / f"bag.{form}"


def _messages(store: Any, form: Form, kind: BagKind) -> Iterator[tuple[str, int, Any]]:
    for number in range(FRAMES):
        stamp_ns = BEGIN_NS + number * STEP_NS
        late_ns = number * (kind.step_ns - STEP_NS)
        color = _color(store, _header(store, form, number, late_ns), kind)
        if number in kind.torn:
            color.data = color.data[: len(color.data) // 3]
        yield kind.color_topic, stamp_ns, color
        if kind.model is not None:
            info = _info(store, _header(store, form, number, 0), form, kind, 30.0)
            beside = kind.color_topic.removesuffix("/compressed").rpartition("/")[0]
            yield f"{beside}/camera_info", stamp_ns, info
        if kind.depth_topic is not None:
            yield (
                kind.depth_topic,
                stamp_ns,
                _depth(store, _header(store, form, number, kind.late_ns), kind),
            )
            info = _info(store, _header(store, form, number, 0), form, kind, kind.depth_focal_px)
            yield f"{kind.depth_topic.rpartition('/')[0]}/camera_info", stamp_ns, info


def _header(store: Any, form: Form, number: int, late_ns: int) -> Any:
    stamp_ns = BEGIN_NS + number * STEP_NS + late_ns
    stamp = store.types["builtin_interfaces/msg/Time"](
        sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9
    )
    counted = {"seq": number} if form == "ros1" else {}
    return store.types["std_msgs/msg/Header"](
        stamp=stamp, frame_id="camera_color_optical_frame", **counted
    )


def _info(store: Any, header: Any, form: Form, kind: BagKind, focal_px: float) -> Any:
    region = store.types["sensor_msgs/msg/RegionOfInterest"](
        x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
    )
    K = np.array([focal_px, 0.0, 11.5, 0.0, focal_px, 7.5, 0.0, 0.0, 1.0])
    P = np.insert(K.reshape(3, 3), 3, 0.0, axis=1).ravel()
    names = ("D", "K", "R", "P") if form == "ros1" else ("d", "k", "r", "p")
    numbers = dict(zip(names, (np.array(kind.coefficients), K, np.eye(3).ravel(), P), strict=True))
    return store.types["sensor_msgs/msg/CameraInfo"](
        header=header, height=HEIGHT, width=kind.info_width, distortion_model=kind.model or "plumb_bob",
        binning_x=0, binning_y=0, roi=region, **numbers,
    )  # fmt: skip


def _color(store: Any, header: Any, kind: BagKind) -> Any:
    if kind.color in ("jpeg", "png"):
        picture = np.full((HEIGHT, WIDTH, 3), COLOR_BGR, np.uint8)
        data = cv2.imencode(f".{kind.color}", picture)[1].ravel()
        return store.types["sensor_msgs/msg/CompressedImage"](
            header=header, format=f"rgb8; {kind.color}", data=data
        )
    pixel = [(*COLOR_BGR, 255)[k] for k in ORDERS.get(kind.color, (0, 1, 2))]
    return _image(
        store, header, kind.color, np.tile(np.array(pixel, np.uint8), (HEIGHT, WIDTH, 1)), kind
    )


def _depth(store: Any, header: Any, kind: BagKind) -> Any:
    depth = np.full((kind.depth_height, WIDTH), DEPTH_MM, np.uint16)
    depth[:2] = 0
    if kind.depth == "compressedDepth":
        data = np.concatenate((np.zeros(12, np.uint8), cv2.imencode(".png", depth)[1].ravel()))
        return store.types["sensor_msgs/msg/CompressedImage"](
            header=header, format="16UC1; compressedDepth png", data=data
        )
    if kind.depth == "32FC1":
        metres = depth.astype(np.float32) * np.float32(kind.unit_m)
        metres[0], metres[1] = np.nan, np.inf
        return _image(store, header, "32FC1", metres, kind)
    return _image(store, header, kind.depth, depth, kind)


def _image(store: Any, header: Any, encoding: str, pixels: NDArray[Any], kind: BagKind) -> Any:
    swapped = pixels.astype(pixels.dtype.newbyteorder(">" if kind.big_endian else "<"))
    rows = np.frombuffer(swapped.tobytes(), np.uint8).reshape(len(pixels), -1)
    padded = np.pad(rows, ((0, 0), (0, kind.padding)))
    return store.types["sensor_msgs/msg/Image"](
        header=header, height=len(pixels), width=pixels.shape[1], encoding=encoding,
        is_bigendian=int(kind.big_endian), step=padded.shape[1], data=padded.ravel(),
    )  # fmt: skip
