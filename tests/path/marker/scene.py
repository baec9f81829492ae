"""Exact images of markers and random views of them, for these tests only."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from path.camera.model import CameraModel
from path.geometry import rotation
from path.geometry.transforms import Matrix, Pose, Vector
from path.marker.layout import MarkerLayout
from path.marker.photometric.texture import cells
from path.observations import Region

VGA = CameraModel(640, 480, 615.0, 614.0, 321.5, 238.0, (0.06, -0.12, 0.001, -0.0008, 0.0))
HD = CameraModel(1280, 720, 920.0, 919.0, 642.0, 358.0, (0.06, -0.12, 0.001, -0.0008, 0.0))
C45 = math.sqrt(0.5)
# marker on D1's tail, facing back and up
R_B_V = np.array([[0.0, C45, -C45], [1.0, 0.0, 0.0], [0.0, -C45, -C45]])
# camera pitched down by 45 degrees
R_B_C = np.array([[0.0, -C45, C45], [1.0, 0.0, 0.0], [0.0, C45, C45]])


@dataclass(frozen=True)
class View:
    """A true pose with the gravity directions both drones would report without error."""

    T_c_v: Pose
    gravity_v: Vector
    gravity_c: Vector


def random_view(
    rng: np.random.Generator, camera: CameraModel, near_m: float, far_m: float, cone_deg: float
) -> View:
    """D1 and D2 nearly level, the marker well inside D2's image, seen at most ``cone_deg`` off its
    normal.
    """
    while True:
        tilt1, tilt2 = rng.normal(0.0, math.radians(4.0), (2, 2))
        R_n_v = rotation.R_from_rpy(tilt1[0], tilt1[1], 0.0) @ R_B_V
        incidence, around = (
            math.radians(cone_deg) * math.sqrt(rng.uniform()),
            rng.uniform(-math.pi, math.pi),
        )
        toward = np.array(
            [
                math.sin(incidence) * math.cos(around),
                math.sin(incidence) * math.sin(around),
                math.cos(incidence),
            ]
        )
        camera_n = R_n_v @ toward * rng.uniform(near_m, far_m)
        heading = math.atan2(-camera_n[1], -camera_n[0]) + rng.uniform(-0.3, 0.3)
        R_n_c = rotation.R_from_rpy(tilt2[0], tilt2[1], heading) @ R_B_C
        T_c_v = Pose(R_n_c.T @ R_n_v, -R_n_c.T @ camera_n)
        x, y, z = T_c_v.t.tolist()
        if camera.sees((x, y, z), margin_px=60.0):
            return View(T_c_v, R_n_v[2].copy(), R_n_c[2].copy())


def tilted(direction: Vector, sigma_rad: float, rng: np.random.Generator) -> Vector:
    """A direction measured with an attitude error of ``sigma_rad`` per axis."""
    return rotation.exp(rng.normal(0.0, sigma_rad, 3)) @ direction


def true_corners(
    camera: CameraModel, T_c_v: Pose, layout: MarkerLayout, marker_id: int = 0
) -> NDArray[np.float64]:
    marker = layout.marker(marker_id)
    assert marker is not None
    return camera.project(T_c_v.apply(marker.corners_v))


def region_around(corners_px: NDArray[np.float64], half_px: float) -> Region:
    u, v = corners_px.mean(axis=0).tolist()
    return Region(u - half_px, v - half_px, u + half_px, v + half_px)


@dataclass(frozen=True)
class Optics:
    """The optics between the light and the pixel."""

    blur_px: float = 0.7
    noise: float = 2.0
    gamma: float = 1.0
    black: float = 30.0
    white: float = 200.0
    shade: float = 0.1  # relative change of light across the marker
    samples: int = 8


@dataclass(frozen=True)
class Plate:
    """A plate that a print was glued to, cut out with a white border of so many cells; it reaches 3
    cells around.
    """

    border: float
    grey: float


PLATE_CELLS = 3


def background(camera: CameraModel, rng: np.random.Generator) -> NDArray[np.float64]:
    """Grey ground with texture at several scales, shape (height, width)."""
    image = np.full((camera.height, camera.width), 105.0)
    for scale, strength in ((80, 25.0), (20, 18.0), (5, 12.0)):
        coarse = rng.normal(0.0, strength, (camera.height // scale + 2, camera.width // scale + 2))
        image += cv2.resize(coarse, (camera.width, camera.height), interpolation=cv2.INTER_LINEAR)
    return image


def render(
    camera: CameraModel,
    T_c_v: Pose,
    layout: MarkerLayout,
    rng: np.random.Generator,
    optics: Optics = Optics(),
    ground: NDArray[np.float64] | None = None,
    plate: Plate | None = None,
) -> NDArray[np.uint8]:
    """The grey image of all markers of a layout, shape (height, width): supersampled, blurred,
    noisy, quantised.
    """
    image = background(camera, rng) if ground is None else ground.copy()
    for marker in layout.markers:
        around = 1 if plate is None else PLATE_CELLS
        texture = np.pad(cells(layout.dictionary, marker.id), around, constant_values=1.0)
        _draw(image, camera, T_c_v @ marker.T_v_m, texture, marker.side_m, optics, plate)
    image += rng.normal(0.0, optics.noise, image.shape)
    if optics.gamma != 1.0:
        image = 255.0 * (np.clip(image, 0.0, 255.0) / 255.0) ** (1.0 / optics.gamma)
    return np.clip(np.rint(image), 0.0, 255.0).astype(np.uint8)


def _draw(
    image: NDArray[np.float64],
    camera: CameraModel,
    T_c_m: Pose,
    texture: Matrix,
    side_m: float,
    optics: Optics,
    plate: Plate | None,
) -> None:
    n = texture.shape[0]
    cell = side_m / (n - 2 * (1 if plate is None else PLATE_CELLS))
    half = 0.5 * n * cell
    ends_px = camera.project(
        T_c_m.apply(half * np.array([[-1.0, 1.0, 0.0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]]))
    )
    margin = 4.0 + 4.0 * optics.blur_px
    u0, v0 = np.floor(ends_px.min(axis=0) - margin).astype(int)
    u1, v1 = np.ceil(ends_px.max(axis=0) + margin).astype(int)
    u, v = np.meshgrid(np.arange(u0, u1, dtype=float), np.arange(v0, v1, dtype=float))
    px = np.stack([u.ravel(), v.ravel()], axis=1)
    right, below = np.array([0.5, 0.0]), np.array([0.0, 0.5])
    ray = camera.rays(px)
    along_u = camera.rays(px + right) - camera.rays(px - right)
    along_v = camera.rays(px + below) - camera.rays(px - below)
    offset = (np.arange(optics.samples) + 0.5) / optics.samples - 0.5
    shape = (*u.shape, 1, 1, 2)
    fine = (
        ray.reshape(shape)
        + along_v.reshape(shape) * offset[None, None, :, None, None]
        + along_u.reshape(shape) * offset[None, None, None, :, None]
    )
    H = np.linalg.inv(np.column_stack([T_c_m.R[:, 0], T_c_m.R[:, 1], T_c_m.t]))
    w = H[2, 0] * fine[..., 0] + H[2, 1] * fine[..., 1] + H[2, 2]
    x = (H[0, 0] * fine[..., 0] + H[0, 1] * fine[..., 1] + H[0, 2]) / w
    y = (H[1, 0] * fine[..., 0] + H[1, 1] * fine[..., 1] + H[1, 2]) / w
    inside = (np.abs(x) < half) & (np.abs(y) < half)
    column = np.clip(((x + half) / cell).astype(int), 0, n - 1)
    row = np.clip(((half - y) / cell).astype(int), 0, n - 1)
    light = 1.0 + optics.shade * (0.6 * x + 0.8 * y) / half
    value = (optics.black + (optics.white - optics.black) * texture[row, column]) * light
    if plate is not None:
        cut_m = 0.5 * side_m + plate.border * cell
        value = np.where(np.maximum(np.abs(x), np.abs(y)) > cut_m, plate.grey, value)
    cut_v, cut_u = (
        slice(max(v0, 0), min(v1, camera.height)),
        slice(max(u0, 0), min(u1, camera.width)),
    )
    behind = np.zeros(u.shape)
    behind[cut_v.start - v0 : cut_v.stop - v0, cut_u.start - u0 : cut_u.stop - u0] = image[
        cut_v, cut_u
    ]
    value = np.where(inside, value, behind[:, :, None, None])
    s = optics.samples
    value = value.transpose(0, 2, 1, 3).reshape(u.shape[0] * s, u.shape[1] * s)
    if optics.blur_px > 0.0:
        value = cv2.GaussianBlur(value, (0, 0), optics.blur_px * s, borderType=cv2.BORDER_REPLICATE)
    patch = value.reshape(u.shape[0], s, u.shape[1], s).mean(axis=(1, 3))
    image[cut_v, cut_u] = patch[
        cut_v.start - v0 : cut_v.stop - v0, cut_u.start - u0 : cut_u.stop - u0
    ]


def covered(
    image: NDArray[np.uint8],
    corners_px: NDArray[np.float64],
    outline: NDArray[np.float64],
    grey: float,
) -> NDArray[np.uint8]:
    """The image with something flat over a part of a marker: ``outline`` in its sides, (0, 0) top
    left to (1, 1).
    """
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]], np.float32)
    H = cv2.getPerspectiveTransform(square, corners_px.astype(np.float32))
    places = cv2.perspectiveTransform(outline.reshape(-1, 1, 2), H.astype(np.float64)).reshape(
        -1, 2
    )
    mask = np.zeros(image.shape[:2], np.uint8)
    cv2.fillPoly(mask, [np.round(16.0 * places).astype(np.int32)], (255,), cv2.LINE_AA, 4)
    share = cv2.GaussianBlur(mask / 255.0, (0, 0), 0.7)
    return np.clip(np.rint((1.0 - share) * image + share * grey), 0.0, 255.0).astype(np.uint8)
