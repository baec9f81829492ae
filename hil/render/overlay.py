"""The things on the ground of a scene, and the light on it: litter, painted lines, shadows,
reflected lamps, glare.

Flat polygons on the ground, drawn over it before the bodies are. A polygon that reaches behind the
camera or out of the lens is left out: they are small.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from hil.render.looks import Look
from hil.render.scene import ROTOR, Body
from path.arrays import Array, Singles
from path.camera.model import CameraModel
from path.geometry.transforms import Pose
from path.values import frozen

Planes = NDArray[np.uint8]

SHIFT = 4  # bits of a pixel's fraction, in OpenCV's polygons
NEAREST_M = 0.05
AREA_M = 9.0  # litter lies within this much of the origin, north and east
LOWEST_SUN = 0.05  # sine of the elevation: below it nothing casts a shadow
# painted lines: width, distance, length of a piece
LINE_M = 0.05
GRID_M = 2.0
PIECE_M = 0.5
LAMP_GRID_M = 3.0
LAMP_HEIGHT_M = 5.0
LAMP_M = 0.35
LAMP_LEVELS = 95.0
LAMP_BLUR_PX = 5.0
VEIL_POWER = 3.0
LEAVES = ((30.0, 62.0, 96.0), (26.0, 80.0, 120.0), (40.0, 96.0, 92.0), (24.0, 40.0, 66.0))
STONES = ((118.0, 120.0, 122.0), (66.0, 70.0, 74.0), (150.0, 152.0, 150.0), (44.0, 44.0, 46.0))
PAINT = ((188.0, 190.0, 190.0), (70.0, 170.0, 190.0))


@frozen(eq=False)
class GroundPatches:
    """Polygons on the ground: corners east and north in m, (n, 4, 2), and colours BGR, (n, 3)."""

    corners: Array
    colors: Array


def patches(look: Look, seed: int) -> GroundPatches:
    """Return what lies about in a scene; where, is drawn from the seed."""
    if look.litter == "lines":
        return _lines()
    rng = np.random.default_rng([seed, 0x6C6974])
    count = 0 if look.litter == "none" else look.pieces
    middles = rng.uniform(-AREA_M, AREA_M, (count, 1, 2))
    turn = rng.uniform(0.0, 2.0 * np.pi, (count, 1))
    stones = look.litter == "stones"
    size = rng.uniform(0.015, 0.07, (count, 1)) if stones else rng.uniform(0.02, 0.06, (count, 1))
    angles = turn + np.arange(4) * (0.5 * np.pi) + rng.uniform(-0.4, 0.4, (count, 4))
    flat = 1.0 if stones else np.array((1.0, 0.45, 1.0, 0.45))
    corners = middles + (size * flat)[..., None] * np.stack(
        (np.cos(angles), np.sin(angles)), axis=-1
    )
    palette = np.array(STONES if stones else LEAVES)
    return GroundPatches(corners, palette[rng.integers(0, len(palette), count)])


def _lines() -> GroundPatches:
    """The painted lines of a hall, in short pieces."""
    half = 0.5 * LINE_M
    along = np.arange(-AREA_M, AREA_M, PIECE_M)
    corners: list[Array] = []
    colors: list[tuple[float, float, float]] = []
    for number, at in enumerate(np.arange(-AREA_M + 0.5 * GRID_M, AREA_M, GRID_M)):
        for begin in along:
            piece = np.array([[begin, at - half], [begin + PIECE_M, at - half], [begin + PIECE_M, at + half],
                              [begin, at + half]])  # fmt: skip
            corners += [piece, piece[:, ::-1]]
            colors += [PAINT[number % 2]] * 2
    return GroundPatches(np.array(corners), np.array(colors))


class Overlay:
    """Draws one scene's overlay into the light that a camera sees of the ground."""

    def __init__(
        self,
        look: Look,
        camera: CameraModel,
        rays: Sequence[Singles],
        seed: int,
    ) -> None:
        """``rays``: x and y of each pixel's ray on z = 1, (h, w) each."""
        self._look = look
        self._camera = camera
        self._patches = patches(look, seed)
        length = np.sqrt(rays[0] ** 2 + rays[1] ** 2 + np.float32(1.0))
        self._directions = rays[0] / length, rays[1] / length, np.float32(1.0) / length
        self._mask = np.zeros((camera.height, camera.width), np.uint8)
        strength = float(np.linalg.norm(look.sun_w))
        self._sun = look.sun_w / strength
        self._gains = [
            np.round(np.clip(np.arange(256) * gain, 0.0, 255.0)).astype(np.uint8)
            for gain in look.gain
        ]

    def on_ground(
        self,
        T_w_c: Pose,
        casters: Sequence[Body],
        image: Planes,
    ) -> None:
        """Litter, reflections and shadows, into ``image`` (3, h, w) of the ground alone."""
        T_c_w = T_w_c.inverse()
        found = self._patches
        if len(found.corners):
            points = np.concatenate(
                (found.corners, np.zeros((*found.corners.shape[:2], 1))), axis=2
            )
            polygons, colors = self._visible(points, found.colors, T_c_w)
            for polygon, color in zip(polygons, colors.tolist(), strict=True):
                for plane, level in zip(image, color, strict=True):
                    cv2.fillConvexPoly(plane, polygon, level, cv2.LINE_AA, SHIFT)
        if self._look.lamps:
            self._reflect(T_w_c, image)
        if self._look.shadow > 0.0 and self._sun[2] > LOWEST_SUN:
            self._darken(T_c_w, casters, image)

    def over_all(self, T_w_c: Pose, image: Planes) -> None:
        """Glare, and the light's colour and strength, over the whole ``image``."""
        if self._look.veil > 0.0:
            x, y, z = (T_w_c.R.T @ self._sun).astype(np.float32)
            towards = np.maximum(
                self._directions[0] * x + self._directions[1] * y + self._directions[2] * z, 0.0
            )
            veil = np.round(self._look.veil * towards**VEIL_POWER).astype(np.uint8)
            for plane in image:
                cv2.add(plane, veil, plane)
        for plane, gains in zip(image, self._gains, strict=True):
            cv2.LUT(plane, gains, plane)

    def _visible(
        self,
        points_w: Array,
        colors: Array,
        T_c_w: Pose,
    ) -> tuple[list[NDArray[np.int32]], Array]:
        """Polygons (n, k, 3) of the world that are in the image, as OpenCV takes them, and their
        colours.
        """
        count, corners = points_w.shape[:2]
        seen = T_c_w.apply(points_w.reshape(-1, 3))
        ahead = seen[:, 2] > NEAREST_M
        seen[~ahead] = 0.0, 0.0, 1.0
        ahead &= np.hypot(seen[:, 0], seen[:, 1]) < self._camera.max_radius * seen[:, 2]
        whole = ahead.reshape(count, corners).all(axis=1)
        pixels = self._camera.project(seen).reshape(count, corners, 2)
        low = pixels.min(axis=1)
        high = pixels.max(axis=1)
        size = np.array((self._camera.width, self._camera.height))
        kept = (
            whole
            & (high > -1.0).all(axis=1)
            & (low < size).all(axis=1)
            & (high - low < 8.0 * size).all(axis=1)
        )
        scaled = np.round(pixels[kept] * (1 << SHIFT)).astype(np.int32)
        return list(scaled), colors[kept]

    def _darken(
        self,
        T_c_w: Pose,
        casters: Sequence[Body],
        image: Planes,
    ) -> None:
        """Shadows of the bodies: every rectangle, carried to the ground along the sun's rays."""
        mask = self._mask
        mask.fill(0)
        for body in casters:
            corners = body.model.corners[body.model.kinds != ROTOR]
            p0 = corners[:, :3]
            e1 = corners[:, 3:6]
            e2 = corners[:, 6:9]
            points = np.stack((p0, p0 + e1, p0 + e1 + e2, p0 + e2), axis=1)
            placed = body.T_w_body.apply(points.reshape(-1, 3)).reshape(points.shape)
            height = np.maximum(placed[..., 2:], 0.0)
            for polygon in self._visible(
                placed - height / self._sun[2] * self._sun,
                corners,
                T_c_w,
            )[0]:
                cv2.fillConvexPoly(mask, polygon, 255, cv2.LINE_AA, SHIFT)
        if not mask.any():
            return
        soft = cv2.GaussianBlur(mask, (0, 0), self._look.penumbra_px)
        kept = np.round(255.0 - self._look.shadow * soft).astype(np.uint8)
        for plane in image:
            cv2.multiply(plane, kept, plane, 1.0 / 255.0)

    def _reflect(self, T_w_c: Pose, image: Planes) -> None:
        """Lamps on a grid above, as a floor that shines a little shows them: as if they were as far
        below it.
        """
        mask = self._mask
        mask.fill(0)
        grid = np.arange(-AREA_M, AREA_M + 0.1, LAMP_GRID_M)
        east, north = (each.ravel() for each in np.meshgrid(grid, grid))
        middle = np.stack((east, north, np.full(len(east), -LAMP_HEIGHT_M)), axis=1)
        offsets = 0.5 * LAMP_M * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
        points = middle[:, None, :] + offsets[None]
        for polygon in self._visible(points, middle, T_w_c.inverse())[0]:
            cv2.fillConvexPoly(mask, polygon, 255, cv2.LINE_AA, SHIFT)
        if mask.any():
            glow = np.round(
                cv2.GaussianBlur(mask, (0, 0), LAMP_BLUR_PX) * (LAMP_LEVELS / 255.0)
            ).astype(np.uint8)
            for plane in image:
                cv2.add(plane, glow, plane)
