"""Read the cameras of other programs' calibrations, each with its own lens.

ROS camera_info and Kalibr camera chains (YAML), OpenCV's FileStorage (YAML, XML, JSON), COLMAP's
cameras.txt, and the JSON of RealSense and DepthAI programs. Formats: by the documentation of each.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import cv2
import numpy as np
import yaml

from drivers.interfaces import CameraError
from drivers.rig.foreign_calibration import (
    COLMAP,
    DEPTHAI,
    KALIBR,
    MATRIX,
    NUMBERS,
    OPENCV,
    REALSENSE,
    ROS,
    program_of,
)
from path.arrays import Array
from path.camera.lenses import Lens, LensKind

Size = tuple[int, int]
Lenses = dict[str, Lens]

READ = "ROS, Kalibr, OpenCV, COLMAP, RealSense and DepthAI calibrations are read"
SIZE = "say the size of its images with --size 1280x720"
# how many of Brown-Conrady's rational coefficients each count of numbers has; those behind them
# are of thin prisms and of a tilted sensor, and must be zero
PLAIN = (4, 5)
RATIONAL = (8, 12, 14)

COLMAP_LENSES: dict[str, tuple[LensKind, str]] = {
    "SIMPLE_PINHOLE": ("brown_conrady", "f cx cy"),
    "PINHOLE": ("brown_conrady", "fx fy cx cy"),
    "SIMPLE_RADIAL": ("brown_conrady", "f cx cy k1"),
    "RADIAL": ("brown_conrady", "f cx cy k1 k2"),
    "OPENCV": ("brown_conrady", "fx fy cx cy k1 k2 p1 p2"),
    "FULL_OPENCV": ("rational", "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6"),
    "SIMPLE_RADIAL_FISHEYE": ("equidistant", "f cx cy k1"),
    "RADIAL_FISHEYE": ("equidistant", "f cx cy k1 k2"),
    "OPENCV_FISHEYE": ("equidistant", "fx fy cx cy k1 k2 k3 k4"),
}
"""COLMAP's models that are known here: the lens, and the order of their parameters."""
NAMES: dict[LensKind, str] = {
    "brown_conrady": "k1 k2 p1 p2 k3",
    "rational": "k1 k2 p1 p2 k3 k4 k5 k6",
    "equidistant": "k1 k2 k3 k4",
}
ROS_LENSES = {
    "": False,
    "none": False,
    "plumb_bob": False,
    "rational_polynomial": False,
    "equidistant": True,
    "fisheye": True,
}
"""ROS's models that are known here, and whether each is a fisheye's."""
KALIBR_LENSES = ("radtan", "radtan5", "radial-tangential", "equidistant", "none")
REALSENSE_LENSES: Sequence[tuple[str, LensKind]] = (
    ("inverse", "inverse_brown_conrady"),
    ("modified", "modified_brown_conrady"),
    ("kannala", "equidistant"),
    ("brown", "brown_conrady"),
    ("none", "brown_conrady"),
)
OPENCV_PAIRS = (
    ("cameramatrix", "distortioncoefficients"),
    ("cameramatrix", "distcoeffs"),
    ("cameramatrix", "distortion"),
    ("intrinsicmatrix", "distcoeffs"),
    ("mtx", "dist"),
    ("k", "d"),
    ("k1", "d1"),
    ("k2", "d2"),
    ("m1", "d1"),
    ("m2", "d2"),
)
"""Names that OpenCV's own programs and those of others give a camera, without underscores."""


class ForeignError(CameraError):
    """A calibration of another program that cannot be read, or has a lens that is not known."""


def foreign_lenses(text: str, size: Size | None = None) -> Lenses:
    """Return the cameras of a file by their names there.

    Args:
        size: of the images, px, for a file that does not say.

    Raises:
        ForeignError: what it is instead, what is missing, or which lens it has.
    """
    program = program_of(text)
    read = READERS.get(program or "")
    if read is None:
        what = "no calibration that is known" if program is None else program
        raise ForeignError(f"this is {what}", NUMBERS if program else READ)
    try:
        found = read(text, size)
    except ForeignError:
        raise
    except (yaml.YAMLError, json.JSONDecodeError, cv2.error, SystemError) as error:
        reason = str(error).splitlines()[0]
        raise ForeignError(f"{program} that is damaged: {reason}", "write it again") from error
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise ForeignError(f"{program} in which something is missing: {error}", NUMBERS) from error
    if not found:
        raise ForeignError(f"{program} with no camera in it", READ)
    return found


def _of_ros(text: str, size: Size | None) -> Lenses:
    """A camera_info as files have it, as it is printed, or a matrix and its distortion alone."""
    info = yaml.safe_load(text)
    numbers = [float(k) for k in _data(info, "distortion_coefficients", "dist_coeffs", "d", "D")]
    model = str(info.get("distortion_model", "plumb_bob")).lower()
    matrix = _data(info, "camera_matrix", "k", "K").reshape(3, 3)
    width = info.get("image_width", info.get("width"))
    height = info.get("image_height", info.get("height"))
    own = size if width is None or height is None else (int(width), int(height))
    if own is None:
        raise ForeignError("it does not say of what size its images are", SIZE)
    return {str(info.get("camera_name", "camera")): ros_lens(model, own, matrix, numbers)}


def ros_lens(
    model: str,
    size: Size,
    matrix: Array,
    numbers: Sequence[float],
) -> Lens:
    """Return the lens of a camera_info. Raises ForeignError for one that is not known."""
    bends = ROS_LENSES.get(model)
    if bends is None:
        raise ForeignError(f"a lens of a kind that is not known: {model}", READ)
    if bends and not numbers:
        numbers = (0.0,) * 4
    return _lens(size, matrix, numbers, bends)


def _data(info: Mapping[str, Any], *names: str) -> Array:
    """Return the numbers of a matrix by any of its names. Raises KeyError."""
    name = next((name for name in names if name in info), names[0])
    value = info[name]
    return np.array(value["data"] if isinstance(value, Mapping) else value, float).ravel()


def _of_kalibr(text: str, size: Size | None) -> Lenses:
    """A chain of cameras, or one alone (EuRoC)."""
    chain = yaml.safe_load(text)
    if "intrinsics" in chain:
        chain = {"camera": chain}
    found: Lenses = {}
    for name, camera in chain.items():
        if not isinstance(camera, Mapping) or "intrinsics" not in camera:
            continue
        lens = str(camera.get("distortion_model", "none")).lower()
        if camera["camera_model"] != "pinhole" or lens not in KALIBR_LENSES:
            raise ForeignError(
                f"{name}: a lens of a kind that is not known: {camera['camera_model']}, {lens}",
                "calibrate it as pinhole-radtan or pinhole-equi, or with `path-handoff calibrate camera`",
            )
        fx, fy, cx, cy = camera["intrinsics"]
        matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        width, height = camera["resolution"]
        given = camera.get("distortion_coeffs", camera.get("distortion_coefficients", ()))
        numbers = [float(k) for k in given]
        found[str(name)] = _lens((width, height), matrix, numbers, lens == "equidistant")
    return found


def _of_opencv(text: str, size: Size | None) -> Lenses:
    storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
    try:
        root = storage.root()
        names = root.keys() if root.isMap() else ()
        nodes = {_plain(name): root.getNode(name) for name in names}
        own = _size_of(nodes) or size
        bends = "fisheyemodel" in nodes and nodes["fisheyemodel"].real() > 0.0
        found: Lenses = {}
        for matrix, lens in OPENCV_PAIRS:
            if matrix not in nodes or lens not in nodes:
                continue
            if own is None:
                raise ForeignError("it does not say of what size its images are", SIZE)
            numbers = [float(k) for k in nodes[lens].mat().ravel()]
            found[matrix] = _lens(own, nodes[matrix].mat(), numbers, bends)
    finally:
        storage.release()
    return found


def _plain(name: str) -> str:
    return name.replace("_", "").replace("-", "").lower()


def _size_of(nodes: Mapping[str, Any]) -> Size | None:
    for width, height in (("imagewidth", "imageheight"), ("width", "height")):
        if width in nodes and height in nodes:
            return int(nodes[width].real()), int(nodes[height].real())
    for name in ("imagesize", "size"):
        if name in nodes and nodes[name].size() == 2:
            return int(nodes[name].at(0).real()), int(nodes[name].at(1).real())
    return None


def _of_colmap(text: str, size: Size | None) -> Lenses:
    found: Lenses = {}
    for line in text.splitlines():
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        name, model, width, height, *numbers = words
        if model not in COLMAP_LENSES:
            raise ForeignError(f"camera {name}: a lens of a kind that is not known: {model}", READ)
        kind, order = COLMAP_LENSES[model]
        given = dict(zip(order.split(), map(float, numbers), strict=True))
        # COLMAP's first pixel has its middle at (0.5, 0.5), OpenCV's at (0, 0)
        found[name] = Lens(
            kind,
            int(width),
            int(height),
            given.get("fx", given.get("f", 0.0)),
            given.get("fy", given.get("f", 0.0)),
            given["cx"] - 0.5,
            given["cy"] - 0.5,
            tuple(given.get(key, 0.0) for key in NAMES[kind].split()),
        )
    return found


def _of_realsense(text: str, size: Size | None) -> Lenses:
    found: Lenses = {}
    for name, it in _tables(json.loads(text), "camera"):
        if not {"fx", "fy", "ppx", "ppy"} <= it.keys():
            continue
        model = str(it.get("model", "")).lower()
        numbers = [float(k) for k in it.get("coeffs", it.get("coefficients", ()))]
        bends = realsense_lens(model, numbers)
        if bends is None:
            raise ForeignError(f"{name}: a lens of a kind that is not known: {model}", READ)
        own = (int(it["width"]), int(it["height"])) if "width" in it else size
        if own is None:
            raise ForeignError("it does not say of what size its images are", SIZE)
        fx, fy, cx, cy = (float(it[key]) for key in ("fx", "fy", "ppx", "ppy"))
        kind, coefficients = bends
        found[name] = Lens(kind, *own, fx, fy, cx, cy, coefficients)
    return found


def realsense_lens(
    model: str, numbers: Sequence[float]
) -> tuple[LensKind, tuple[float, ...]] | None:
    """Return the kind of a lens and its coefficients by librealsense's name of the kind; None for
    one that is not known.
    """
    kind: LensKind | None = next((kind for word, kind in REALSENSE_LENSES if word in model), None)
    if not any(numbers) and kind != "equidistant":
        return "brown_conrady", (0.0,) * 5
    return None if kind is None else (kind, tuple(numbers[: 4 if kind == "equidistant" else 5]))


def _of_depthai(text: str, size: Size | None) -> Lenses:
    found: Lenses = {}
    for socket, camera in json.loads(text)["cameraData"]:
        bends = int(camera.get("cameraType", 0)) == 1
        numbers = [float(k) for k in camera["distortionCoeff"]]
        matrix = np.array(camera["intrinsicMatrix"], float)
        own = int(camera["width"]), int(camera["height"])
        found[f"socket {socket}"] = _lens(own, matrix, numbers[:4] if bends else numbers, bends)
    return found


def _tables(value: Any, name: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield every table of a JSON value, with the key that it is at."""
    if isinstance(value, Mapping):
        yield name, value
        for key, inner in value.items():
            yield from _tables(inner, str(key))
    elif isinstance(value, list):
        for at, inner in enumerate(value):
            yield from _tables(inner, f"{name} {at}")


def _lens(
    size: Size,
    matrix: Any,
    numbers: Sequence[float],
    bends: bool,
) -> Lens:
    """Return the lens of numbers in OpenCV's order. Raises ForeignError for one that is not
    known.
    """
    fx, fy, cx, cy = (float(matrix[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    if bends:
        return Lens("equidistant", *size, fx, fy, cx, cy, tuple(numbers))
    if any(numbers[8:]):
        raise ForeignError("a lens with thin prisms, or of a tilted sensor", READ)
    if len(numbers) in RATIONAL and any(numbers[5:8]):
        return Lens("rational", *size, fx, fy, cx, cy, tuple(numbers[:8]))
    if len(numbers) not in (0, *PLAIN, *RATIONAL):
        raise ForeignError(f"a lens of {len(numbers)} coefficients", READ)
    five = (*numbers[:5], 0.0, 0.0, 0.0, 0.0, 0.0)[:5]
    return Lens("brown_conrady", *size, fx, fy, cx, cy, five)


READERS: dict[str, Callable[[str, Size | None], Lenses]] = {
    ROS: _of_ros,
    MATRIX: _of_ros,
    KALIBR: _of_kalibr,
    OPENCV: _of_opencv,
    COLMAP: _of_colmap,
    REALSENSE: _of_realsense,
    DEPTHAI: _of_depthai,
}
