"""A recorded RGB-D sequence with poses, as 7-Scenes has them, and pairs of its frames.

A folder has ``frame-NNNNNN.color.jpg`` (or png), ``.depth.png`` (mm) and ``.pose.txt`` (4 x 4, depth
camera in the world), ``camera-intrinsics.txt`` of the depth camera and ``gravity-direction.txt`` in
the world.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from drivers.interfaces import PartError
from drivers.recordings.recording import read_image
from path.arrays import Array, Image, Singles
from path.camera.model import CameraModel
from path.common_view.read import RgbdCamera
from path.geometry import rotation
from path.geometry.transforms import Pose

KINECT_COLOR = CameraModel(640, 480, 528.5, 528.5, 320.0, 240.0)
KINECT_COLOR_DEPTH = Pose(
    rotation.exp(np.array([0.0015, 0.003, 0.009])), np.array([-0.0256, 0.0, 0.002])
)
"""The colour camera beside the depth camera, by edges: where depth jumps, colour changes most. What
is published for these sequences is six to eight pixels off."""
DEPTH_SIGMA_AT_1M_M = 0.002
LEAST_MM, MOST_MM = 300, 6000
STEP_PX = 16
SAME_M = 0.1
INTRINSICS = "camera-intrinsics.txt"
GRAVITY = "gravity-direction.txt"


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame. ``T_w_c``: its depth camera in the world. ``stem``: its files without endings."""

    stem: Path
    T_w_c: Pose

    def depth(self) -> Singles:
        """Return depth in metres, 0 where unknown."""
        return _depth(self.stem.with_name(f"{self.stem.name}.depth.png"))

    def color(self) -> Image:
        """Return the colour image, BGR."""
        files = [self.stem.with_name(f"{self.stem.name}.color.{end}") for end in ("jpg", "png")]
        return read_image(files[0] if files[0].is_file() else files[1])


@dataclass(frozen=True, slots=True)
class Sequence:
    """All frames of a folder, the camera, and ``R_l_w``: the world, levelled."""

    frames: tuple[Frame, ...]
    camera: RgbdCamera
    R_l_w: Array


@dataclass(frozen=True, slots=True)
class Pair:
    """Two frames by their numbers in the sequence, and the angle between their views, degrees."""

    first: int
    second: int
    angle_deg: float


def read_sequence(folder: Path) -> Sequence:
    """Return the sequence in a folder. Raises PartError for what is missing or cannot be read."""
    intrinsics = _numbers(folder / INTRINSICS, (3, 3))
    down = _numbers(folder / GRAVITY, (3,))
    stems = sorted(folder.glob("frame-*.pose.txt"))
    if not stems:
        raise PartError(f"{folder}: no frame-*.pose.txt", "name a folder as 7-Scenes has them")
    frames: list[Frame] = []
    for file in stems:
        T = _numbers(file, (4, 4))
        frames.append(Frame(file.with_name(file.name.removesuffix(".pose.txt")), _pose(T)))
    height, width = frames[0].depth().shape
    depth = CameraModel(
        width,
        height,
        intrinsics[0, 0],
        intrinsics[1, 1],
        intrinsics[0, 2],
        intrinsics[1, 2],
    )
    camera = RgbdCamera(KINECT_COLOR, depth, KINECT_COLOR_DEPTH, DEPTH_SIGMA_AT_1M_M)
    return Sequence(tuple(frames), camera, levelled(down))


def levelled(down: Array) -> Array:
    """Return the rotation (3, 3) that turns a direction to z."""
    z = down / np.linalg.norm(down)
    side = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = side - z * (side @ z)
    x /= np.linalg.norm(x)
    return np.asarray(np.stack([x, np.cross(z, x), z]), np.float64)


def pairs_between(
    sequence: Sequence, angles_deg: tuple[float, float], distances_m: tuple[float, float],
    overlap: float, most: int, rng: np.random.Generator,
) -> list[Pair]:  # fmt: skip
    """Return pairs, drawn at random, whose views are apart by an angle and a distance, and the
    second of which shows enough of what the first does.
    """
    R = np.array([frame.T_w_c.R for frame in sequence.frames])
    t = np.array([frame.T_w_c.t for frame in sequence.frames])
    traces = np.einsum("aij,bij->ab", R, R)
    angles = np.degrees(np.arccos(np.clip(0.5 * (traces - 1.0), -1.0, 1.0)))
    apart = np.linalg.norm(t[:, None] - t[None], axis=2)
    fits = (angles >= angles_deg[0]) & (angles < angles_deg[1])
    fits &= (apart >= distances_m[0]) & (apart <= distances_m[1])
    found: list[Pair] = []
    for first, second in rng.permutation(np.argwhere(fits)).tolist():
        if len(found) == most:
            break
        if common(sequence, first, second) > overlap:
            found.append(Pair(first, second, float(angles[first, second])))
    return found


def common(
    sequence: Sequence,
    first: int,
    second: int,
) -> float:
    """Return the share of the second's depth that the first measured too."""
    one = sequence.frames[first]
    two = sequence.frames[second]
    camera = sequence.camera.depth
    depth = two.depth()
    v, u = np.mgrid[STEP_PX // 2 : camera.height : STEP_PX, STEP_PX // 2 : camera.width : STEP_PX]
    z = depth[v, u].astype(np.float64)
    points = np.stack([(u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z], -1)
    points = (one.T_w_c.inverse() @ two.T_w_c).apply(points[z > 0.0])
    pixels = camera.project(points)
    most = np.array([camera.width - 1.0, camera.height - 1.0])
    with np.errstate(invalid="ignore"):  # behind the camera there is no pixel
        inside = np.all((pixels >= 0.0) & (pixels <= most), axis=1)
    seen = np.rint(pixels[inside]).astype(np.int64)
    there = one.depth()[seen[:, 1], seen[:, 0]]
    same = (there > 0.0) & (np.abs(there - points[inside, 2]) < SAME_M)
    return float(np.count_nonzero(same)) / max(1, len(points))


def every(pairs: list[Pair], number: int) -> Iterator[tuple[int, Pair]]:
    """Yield so many pairs with their numbers: some again when there are fewer."""
    for k in range(number if pairs else 0):
        yield k, pairs[k % len(pairs)]


def _pose(T: Array) -> Pose:
    # Of a file with few digits: the nearest rotation.
    U, _, V = np.linalg.svd(T[:3, :3])
    R: Array = U @ V
    return Pose(R, T[:3, 3].copy())


def _numbers(file: Path, shape: tuple[int, ...]) -> Array:
    try:
        numbers = np.loadtxt(file).reshape(shape)
    except (OSError, ValueError) as error:
        wanted = " x ".join(str(n) for n in shape)
        raise PartError(f"{file}: {error}", f"a text file of {wanted} numbers") from error
    return np.asarray(numbers, np.float64)


@lru_cache(maxsize=128)
def _depth(file: Path) -> Singles:
    raw = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    if raw is None:
        raise PartError(f"{file}: no image that can be read", "name a folder with all its frames")
    depth = np.asarray(raw, np.float32) / np.float32(1000.0)
    depth[(raw < LEAST_MM) | (raw > MOST_MM)] = 0.0
    return depth
