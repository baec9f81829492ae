"""Small rooms of textured rectangles, and what an RGB-D camera sees of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from path.camera.model import CameraModel
from path.common_view.keyframe import Keyframe
from path.common_view.read import OWN, SENT, RgbdCamera, Size, read_keyframe
from path.common_view.search import Prior
from path.geometry import rotation

Array = NDArray[np.float64]
LENS = CameraModel(320, 240, 280.0, 280.0, 160.0, 120.0)
DEPTH_SIGMA = 0.002  # at 1 m
GRAVITY_SIGMA = math.radians(0.5)
TEXELS = 512


@dataclass(frozen=True)
class Rectangle:
    """A rectangle from a corner along two edges, m, and its grey texture."""

    corner: tuple[float, float, float]
    right: tuple[float, float, float]
    down: tuple[float, float, float]
    texture: NDArray[np.uint8]


def blobs(seed: int) -> NDArray[np.uint8]:
    """Return spots of several sizes that repeat nowhere."""
    rng = np.random.default_rng(seed)
    total = np.zeros((TEXELS, TEXELS))
    for sigma in (3.0, 6.0, 12.0):
        layer = cv2.GaussianBlur(rng.normal(size=(TEXELS, TEXELS)), (0, 0), sigma)
        total += layer / layer.std()
    return np.asarray(np.clip(128.0 + 35.0 * total, 0, 255), np.uint8)


def tiles(a_side: int) -> NDArray[np.uint8]:
    """Return the same tile again and again."""
    one = blobs(5)[: TEXELS // a_side, : TEXELS // a_side]
    return np.tile(one, (a_side, a_side))


def bare() -> NDArray[np.uint8]:
    return np.full((TEXELS, TEXELS), 128, np.uint8)


def floor(texture: NDArray[np.uint8], side: float = 8.0) -> Rectangle:
    half = 0.5 * side
    return Rectangle((-half, -half, 0.0), (side, 0.0, 0.0), (0.0, side, 0.0), texture)


def room(seed: int) -> list[Rectangle]:
    """Return a floor, two walls and some boxes; z is down, the floor at 0."""
    rng = np.random.default_rng(seed)
    walls = [
        Rectangle((1.5, -4.0, -3.0), (0.0, 8.0, 0.0), (0.0, 0.0, 3.0), blobs(seed + 1)),
        Rectangle((-4.0, 1.8, -3.0), (8.0, 0.0, 0.0), (0.0, 0.0, 3.0), blobs(seed + 2)),
    ]
    scene = [floor(blobs(seed)), *walls]
    for number in range(4):
        x, y = rng.uniform(-0.5, 1.0, 2).tolist()
        side, height = rng.uniform(0.2, 0.6, 2).tolist()
        own = blobs(seed + 10 + number)
        scene += [
            Rectangle((x, y, -height), (side, 0.0, 0.0), (0.0, side, 0.0), own),
            Rectangle((x, y, -height), (0.0, side, 0.0), (0.0, 0.0, height), own),
            Rectangle((x, y, -height), (side, 0.0, 0.0), (0.0, 0.0, height), own),
        ]
    return scene


def looking(place: Sequence[float], at: Sequence[float]) -> tuple[Array, Array]:
    """Return ``R_w_c`` and the place of a camera that looks at a point, upright."""
    forward = np.subtract(at, place)
    forward = forward / np.linalg.norm(forward)
    right = np.cross([0.0, 0.0, 1.0], forward)
    right /= np.linalg.norm(right)
    return np.column_stack([right, np.cross(forward, right), forward]), np.array(place, float)


def around(angle_deg: float, distance_m: float = 2.0, height_m: float = 1.3) -> tuple[Array, Array]:
    """Return a camera at an angle about the room's middle."""
    a = math.radians(225.0 + angle_deg)
    middle = np.array([0.4, 0.4, -0.3])
    away = np.array([distance_m * math.cos(a), distance_m * math.sin(a), 0.3 - height_m])
    return looking((middle + away).tolist(), middle.tolist())


def drawn(
    scene: Sequence[Rectangle], R_w_c: Array, place: Array, rng: np.random.Generator, scale: float = 1.0
) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:  # fmt: skip
    """Return a noisy grey and depth image; ``scale`` makes the whole world larger."""
    v, u = np.mgrid[0 : LENS.height, 0 : LENS.width].astype(float)
    rays = np.stack([(u - LENS.cx) / LENS.fx, (v - LENS.cy) / LENS.fy, np.ones_like(u)], -1)
    rays = rays @ R_w_c.T
    depth = np.full(u.shape, np.inf)
    grey = np.zeros(u.shape)
    for part in scene:
        right = np.array(part.right)
        down = np.array(part.down)
        normal = np.cross(right, down)
        with np.errstate(divide="ignore", invalid="ignore"):
            z = ((np.array(part.corner) - place) @ normal) / (rays @ normal)
        hit = place + z[..., None] * rays - part.corner
        a = hit @ right / (right @ right)
        b = hit @ down / (down @ down)
        inside = (z > 0.1) & (z < depth) & (a >= 0) & (a < 1) & (b >= 0) & (b < 1)
        depth[inside] = z[inside]
        # A texel is as large everywhere: eight metres are the whole texture.
        rows = (b[inside] * np.linalg.norm(down) / 8.0 * 4 * TEXELS).astype(int) % TEXELS
        columns = (a[inside] * np.linalg.norm(right) / 8.0 * 4 * TEXELS).astype(int) % TEXELS
        grey[inside] = part.texture[rows, columns]
    depth[~np.isfinite(depth)] = 0.0
    depth += rng.normal(size=depth.shape) * DEPTH_SIGMA * depth**2
    grey += rng.normal(size=grey.shape) * 2.0
    image = np.asarray(np.clip(cv2.GaussianBlur(grey, (0, 0), 0.7), 0, 255), np.uint8)
    return image, np.asarray(scale * depth, np.float32)


@dataclass(frozen=True)
class Look:
    """Two keyframes, what the drones know before, and the truth in the levelled frames."""

    first: Keyframe
    second: Keyframe
    prior: Prior
    R: Array
    t: Array

    def off(self, yaw_rad: float, t_m: Array) -> Array:
        """Return the error (4,) of a translation and yaw."""
        yaw = math.atan2(self.R[1, 0], self.R[0, 0])
        return np.append(t_m - self.t, math.remainder(yaw_rad - yaw, math.tau))


def looks(
    scene: Sequence[Rectangle], one: tuple[Array, Array], two: tuple[Array, Array], seed: int,
    gravity_deg: float = 0.5, heading_deg: float = 5.0, position_m: float = 0.5, scale: float = 1.0,
) -> Look:  # fmt: skip
    """Return what two drones make of a scene, whose attitudes and positions err by seed."""
    rng = np.random.default_rng(seed)
    camera = RgbdCamera(LENS, LENS, None, DEPTH_SIGMA / scale)
    frames: list[Keyframe] = []
    patch: float | None = None
    sizes: tuple[Size, Size] = (SENT, OWN)
    for (R_w_c, place), size in zip((one, two), sizes, strict=True):
        grey, depth = drawn(scene, R_w_c, place, rng, scale)
        sigmas = np.radians([gravity_deg, gravity_deg, heading_deg / math.sqrt(2.0)])
        R_l_c = rotation.exp(rng.normal(size=3) * sigmas) @ R_w_c
        frames.append(read_keyframe(grey, depth, camera, R_l_c, GRAVITY_SIGMA, size, patch))
        patch = frames[0].patch_m
    R = frames[0].R_l_c @ one[0].T @ two[0] @ frames[1].R_l_c.T
    t = frames[0].R_l_c @ one[0].T @ (two[1] - one[1]) * scale
    sigma = np.full(3, position_m * scale)
    prior = Prior(0.0, math.radians(5.0), t + rng.normal(size=3) * sigma, sigma)
    return Look(frames[0], frames[1], prior, R, t)
