"""A keyframe in parts for a link that loses, delays and reorders them: D1's side and D2's.

``parts_of`` cuts a keyframe into messages. ``Gathered`` puts together what came of the newest one.
No part is asked for again: each one that is missing costs some corners and cells of depth, which
``common_view`` can do without, and the next keyframe is on its way. A part's bytes are those of
``drivers/link/dialect/path.xml``: corners first, then depth.
"""

from __future__ import annotations

import numpy as np

from path.arrays import Array, Flags
from path.camera.model import CameraModel
from path.common_view.keyframe import DESCRIPTOR_BYTES, DepthGrid, Keyframe
from path.common_view.read import Size, grid_lens
from path.geometry.rotation import R_from_quat, quat_from_R
from path.messages import PART_BYTES, KeyframePart
from path.values import frozen

MM = 1000.0
PIXEL = 8.0
"""Places of corners are in such parts of a pixel."""
CORNER_BYTES = 6 + DESCRIPTOR_BYTES
MOST = np.iinfo(np.uint16).max
USABLE = 0.5
"""A keyframe of which less came is not used."""


def part_count(corners: int, size: Size) -> int:
    """Return how many parts a keyframe of so many corners has."""
    rows, columns = size.grid
    return -(-(corners * CORNER_BYTES + 2 * rows * columns) // PART_BYTES)


def parts_of(
    keyframe: Keyframe,
    camera: CameraModel,
    capture_ns: int,
) -> list[KeyframePart]:
    """Return a keyframe in parts.

    Args:
        keyframe: of at most 255 corners; ``R_l_c`` leads to ``n``.
        camera: its depth camera, without distortion.
        capture_ns: when it was seen, the sending drone's clock.
    """
    places = np.empty((len(keyframe.points_c), 3))
    places[:, :2] = PIXEL * camera.project(keyframe.points_c)
    places[:, 2] = MM * keyframe.points_c[:, 2]
    corners = np.empty((len(places), CORNER_BYTES), np.uint8)
    corners[:, :6] = _words(places).view(np.uint8).reshape(-1, 6)
    corners[:, 6:] = keyframe.descriptors
    text = corners.tobytes() + _words(MM * keyframe.grid.depth.astype(np.float64)).tobytes()
    rotation = quat_from_R(keyframe.R_l_c)
    return [
        KeyframePart(
            capture_ns, rotation, keyframe.patch_m, len(corners), number,
            text[start : start + PART_BYTES].ljust(PART_BYTES, b"\0"),
        )
        for number, start in enumerate(range(0, len(text), PART_BYTES))
    ]  # fmt: skip


def _words(values: Array) -> np.ndarray[tuple[int, ...], np.dtype[np.uint16]]:
    """Return numbers as 16 bits, little-endian; what does not fit is 0, and unknown."""
    fits = (values > 0.0) & (values <= MOST)
    return np.where(fits, np.rint(values), 0.0).astype("<u2")


@frozen
class KeyframeSource:
    """What D2 knows of D1's keyframes before any comes in.

    Attributes:
        camera: D1's depth camera, without distortion. ``size``: of its keyframes.
        depth_sigma_at_1m_m, gravity_sigma_rad: as of a ``Keyframe``.
    """

    camera: CameraModel
    size: Size
    depth_sigma_at_1m_m: float
    gravity_sigma_rad: float


class Gathered:
    """What came of D1's newest keyframe.

    Attributes:
        capture_ns: when D1 saw it, D1's clock; 0 before the first.
    """

    def __init__(self, source: KeyframeSource) -> None:
        self._source = source
        self._first: KeyframePart | None = None
        self._parts: dict[int, bytes] = {}
        self._missing = 0

    @property
    def capture_ns(self) -> int:
        return 0 if self._first is None else self._first.capture_ns

    def begins(self, part: KeyframePart) -> bool:
        """Return whether a part is the first that came of a newer keyframe."""
        return part.capture_ns > self.capture_ns

    @property
    def complete(self) -> bool:
        return self._first is not None and len(self._parts) == self._many

    @property
    def usable(self) -> bool:
        """Return whether enough came to be used, if no more comes."""
        return self._first is not None and len(self._parts) >= USABLE * self._many

    @property
    def _many(self) -> int:
        assert self._first is not None
        return part_count(self._first.corners, self._source.size)

    def add(self, part: KeyframePart) -> bool:
        """Take in a part, and return whether it was new; parts of older keyframes are not."""
        if self.begins(part):
            self._first = part
            self._parts = {}
        if part.capture_ns < self.capture_ns or part.number in self._parts:
            return False
        if part.number >= self._many:
            return False
        self._parts[part.number] = part.data
        return True

    def keyframe(self) -> Keyframe:
        """Return the keyframe without what is missing. Call it once there is a part."""
        first = self._first
        assert first is not None, "nothing was gathered"
        source = self._source
        camera = source.camera
        whole = np.zeros((self._many, PART_BYTES), np.uint8)
        there = np.zeros((self._many, PART_BYTES), np.bool_)
        for number, data in self._parts.items():
            whole[number] = np.frombuffer(data, np.uint8)
            there[number] = True
        text = whole.ravel()
        known = there.ravel()
        end = first.corners * CORNER_BYTES
        rows = text[:end].reshape(-1, CORNER_BYTES)
        places = rows[:, :6].copy().view("<u2").astype(np.float64)
        came: Flags = known[:end].reshape(-1, CORNER_BYTES).all(axis=1) & (places[:, 2] > 0.0)
        places = places[came]
        points = np.empty((len(places), 3))
        points[:, 2] = places[:, 2] / MM
        points[:, 0] = (places[:, 0] / PIXEL - camera.cx) / camera.fx * points[:, 2]
        points[:, 1] = (places[:, 1] / PIXEL - camera.cy) / camera.fy * points[:, 2]
        high, wide = source.size.grid
        cells = text[end : end + 2 * high * wide].copy().view("<u2")
        both = known[end : end + 2 * high * wide].reshape(-1, 2).all(axis=1)
        depth = np.where(both, cells, 0).astype(np.float32) / np.float32(MM)
        return Keyframe(
            R_from_quat(first.rotation_n_c),
            DepthGrid(depth.reshape(high, wide), grid_lens(camera, source.size.grid)),
            points,
            rows[came, 6:].copy(),
            first.patch_m,
            source.depth_sigma_at_1m_m,
            source.gravity_sigma_rad,
        )
