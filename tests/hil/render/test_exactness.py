"""The picture is where the camera model says it is: corners to hundredths of a pixel, depth to the
millimetre.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from hil.render.renderer import Renderer
from hil.render.sensor import NOISE_FREE, SensorNoise
from hil.world.snapshot import Snapshot
from path.camera.model import CameraModel
from path.camera.thinning import Thinning
from path.geometry.transforms import Pose
from path.marker.layout import single_marker
from path.marker.photometric.corners import fit
from path.marker.photometric.texture import cells
from path.messages import Role
from tests.hil.render.views import ABOVE, LEVEL, VGA, drone, hovering, looking_at, mount

Array = NDArray[np.float64]

BORDER = 1.0 / 6.0  # a 4x4 marker's black frame over its side


def random_pose(rng: np.random.Generator, nearest: float, farthest: float, most_deg: float) -> Pose:
    """T_c_v somewhere in view, its normal up to ``most_deg`` from the line of sight."""
    position = np.array([rng.uniform(-0.4, 0.4), rng.uniform(-0.3, 0.3), 1.0]) * rng.uniform(
        nearest, farthest
    )
    back = -position / np.linalg.norm(position)
    right = np.cross((0.0, 1.0, 0.0), back)
    right /= np.linalg.norm(right)
    facing = np.column_stack((right, np.cross(back, right), back))
    tilt, towards, spin = (
        np.radians(rng.uniform(0, most_deg)),
        rng.uniform(0, 2 * np.pi),
        rng.uniform(0, 2 * np.pi),
    )
    tilted = cv2.Rodrigues(tilt * np.array([np.cos(towards), np.sin(towards), 0.0]))[0]
    return Pose(facing @ tilted @ cv2.Rodrigues(np.array([0.0, 0.0, spin]))[0], position)


def project(camera: CameraModel, T_c_v: Pose, points_v: Array) -> Array:
    rotation = cv2.Rodrigues(T_c_v.R)[0]
    pixels = cv2.projectPoints(points_v, rotation, T_c_v.t, camera.K, np.array(camera.distortion))[
        0
    ]
    return np.asarray(pixels, float).reshape(-1, 2)


def edge_rays(
    image: Array, camera: CameraModel, T_c_v: Pose, start: Array, end: Array, inward: Array
) -> Array | None:
    """Points on one edge of the black frame as undistorted rays, by the area under profiles across
    it.

    ``inward``: from the edge to the inner side of the black frame. None when the frame is too thin
    in the picture.
    """
    ends = project(camera, T_c_v, np.array((start, end)))
    # a profile must not reach around a corner
    margin = min(0.35, 6.0 / np.hypot(*(ends[1] - ends[0])))
    along = np.linspace(margin, 1.0 - margin, 60)[:, None]
    on_edge = project(camera, T_c_v, start + along * (end - start))
    inside = project(camera, T_c_v, start + along * (end - start) + inward)
    direction = on_edge[-1] - on_edge[0]
    axis = 1 if abs(direction[0]) >= abs(direction[1]) else 0  # profiles run along this image axis
    normal = np.array([-direction[1], direction[0]]) / np.hypot(*direction)
    frame_px = np.abs((inside - on_edge) @ normal).min()
    reach = int(min(3.0, 0.9 * frame_px / abs(normal[axis]) - 1.0))
    if reach < 2:
        return None
    low, high = np.sort(on_edge[[0, -1], 1 - axis])
    order = np.argsort(on_edge[:, 1 - axis])
    points: list[tuple[float, float]] = []
    for position in range(int(np.ceil(low)), int(high) + 1):
        expected = np.interp(position, on_edge[order, 1 - axis], on_edge[order, axis])
        first = round(expected) - reach
        profile = (
            image[first : first + 2 * reach + 1, position]
            if axis == 1
            else image[position, first : first + 2 * reach + 1]
        )
        share = np.sum((profile - profile[-1]) / (profile[0] - profile[-1]))
        found = first - 0.5 + share
        points.append((position, found) if axis == 1 else (found, position))
    return camera.rays(np.array(points, float)) if len(points) >= 2 else None


def measured_corners(image: Array, camera: CameraModel, T_c_v: Pose, side_m: float) -> Array | None:
    corners = single_marker(side_m).markers[0].corners_v
    lines: list[tuple[Array, Array]] = []
    for k in range(4):
        start, end, after = corners[k], corners[(k + 1) % 4], corners[(k + 2) % 4]
        rays = edge_rays(image, camera, T_c_v, start, end, BORDER * (after - end))
        if rays is None:
            return None
        center = rays.mean(axis=0)
        lines.append((center, np.linalg.svd(rays - center)[2][0]))
    found: list[Array] = []
    for k in range(4):
        (p, a), (q, b) = lines[k - 1], lines[k]
        s = np.linalg.solve(np.column_stack((a, -b)), q - p)[0]
        found.append(np.append(p + s * a, 1.0))
    return camera.project(np.array(found))


@pytest.mark.parametrize(
    ("side_m", "farthest_m", "most_deg"), [(0.2, 3.0, 70.0), (0.04, 0.8, 45.0)]
)
def test_marker_corners_are_where_project_points_puts_them(
    side_m: float, farthest_m: float, most_deg: float
) -> None:
    rng = np.random.default_rng(7)
    renderer = Renderer(VGA, LEVEL, ABOVE, single_marker(side_m), NOISE_FREE)
    corners_v = single_marker(side_m).markers[0].corners_v
    errors: list[Array] = []
    while len(errors) < 110:
        T_c_v = random_pose(rng, 0.5, farthest_m, most_deg)
        plate = project(VGA, T_c_v, 1.5 * corners_v)
        if plate.min() < 4 or plate[:, 0].max() > 635 or plate[:, 1].max() > 475:
            continue
        color, _ = renderer.render(looking_at(T_c_v @ ABOVE.inverse()), Role.RECEIVER, 0)
        found = measured_corners(color[..., 1].astype(float), VGA, T_c_v, side_m)
        if found is not None:
            errors.append(np.linalg.norm(found - project(VGA, T_c_v, corners_v), axis=1))
    assert np.median(errors) < 0.01
    assert np.percentile(errors, 99) < 0.08


def test_depth_of_a_tilted_plate_is_exact_to_the_millimetre() -> None:
    rng = np.random.default_rng(3)
    renderer = Renderer(VGA, LEVEL, ABOVE, single_marker(0.2), NOISE_FREE)
    compared = 0
    for _ in range(20):
        T_c_v = random_pose(rng, 0.6, 3.0, 70.0)
        inside = np.array(
            [[x, y, 0.0] for x in np.linspace(-0.13, 0.13, 9) for y in np.linspace(-0.13, 0.13, 9)]
        )
        pixels = np.round(project(VGA, T_c_v, inside))
        pixels = pixels[np.all((pixels >= 0) & (pixels < (640, 480)), axis=1)]
        rays = np.column_stack((VGA.rays(pixels), np.ones(len(pixels))))
        normal = T_c_v.R[:, 2]
        expected_mm = 1000.0 * (normal @ T_c_v.t) / (rays @ normal)
        _, depth = renderer.render(looking_at(T_c_v @ ABOVE.inverse()), Role.RECEIVER, 0)
        seen = depth[pixels[:, 1].astype(int), pixels[:, 0].astype(int)]
        assert np.abs(seen - expected_mm).max() <= 0.501
        compared += len(pixels)
    assert compared > 500


def test_depth_of_the_ground_is_exact_to_the_millimetre() -> None:
    renderer = Renderer(VGA, mount(45.0), LEVEL, single_marker(), NOISE_FREE)
    pose = hovering(0.45, -0.95, 2.1, -0.25)
    bare = Snapshot(0.0, {Role.RECEIVER: drone(pose)}, ())
    _, depth = renderer.render(bare, Role.RECEIVER, 0)
    columns, rows = np.meshgrid(np.arange(640.0), np.arange(480.0))
    rays = np.column_stack(
        (VGA.rays(np.column_stack((columns.ravel(), rows.ravel()))), np.ones(640 * 480))
    )
    T_w_c = pose @ mount(45.0)
    z_mm = -1000.0 * T_w_c.t[2] / (rays @ T_w_c.R[2])
    expected = np.where(z_mm <= 6000.0, z_mm, 0.0).reshape(480, 640)
    clear = np.abs(z_mm.reshape(480, 640) - 6000.0) > 1.0
    assert np.abs(depth - expected)[clear].max() <= 0.501


def test_a_camera_that_leaves_out_pixels_sees_where_its_pixels_are() -> None:
    """Corners fitted with the pattern are where the model projects them; without it they are
    not.
    """
    thinned = replace(VGA, thinning=Thinning(3, 5, (1, 2)))
    rng, layout = np.random.default_rng(8), single_marker(0.2)
    renderer = Renderer(thinned, LEVEL, ABOVE, layout, SensorNoise(read_sigma=0.0, shot_gain=0.0))
    pattern = np.pad(cells(layout.dictionary, 0), 1, constant_values=1.0)
    errors: dict[CameraModel, list[Array]] = {thinned: [], VGA: []}
    while len(errors[VGA]) < 12:
        T_c_v = random_pose(rng, 2.5, 3.5, 45.0)
        corners = project(VGA, T_c_v, layout.markers[0].corners_v)
        if corners.min() < 20 or corners[:, 0].max() > 620 or corners[:, 1].max() > 460:
            continue
        color, _ = renderer.render(looking_at(T_c_v @ ABOVE.inverse()), Role.RECEIVER, 0)
        for camera, off in errors.items():
            fitted = fit(np.ascontiguousarray(color[..., 1]), (0, 0), corners, camera, pattern)
            assert fitted is not None
            off.append(fitted.corners_px - corners)
    even, uneven = (float(np.sqrt(np.mean(np.square(off)))) for off in errors.values())
    assert even < 0.03
    assert uneven > 2.0 * even
