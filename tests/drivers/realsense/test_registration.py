"""Depth in the colour camera's pixels: against librealsense where it is right, and by rays where it
is not.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.realsense.registration import DepthRegistration
from drivers.realsense.sdk_import import import_realsense
from hil.camera.d415 import T_COLOR_DEPTH, depth_camera
from hil.camera.software_device import SoftwareDevice
from path.camera.model import CameraModel
from path.geometry.transforms import Pose

PLAIN = CameraModel(320, 240, 307.6, 307.9, 161.0, 120.6)
LENS = replace(PLAIN, distortion=(0.112, -0.236, 0.0006, -0.0004, 0.095))
DEPTH = depth_camera(320, 240)
LIMITS_M = (0.3, 6.0)
UNIT_M = 0.001


def registered(
    depth: NDArray[np.uint16],
    color: CameraModel = LENS,
    unit_m: float = UNIT_M,
    T: Pose = T_COLOR_DEPTH,
) -> NDArray[np.uint16]:
    return DepthRegistration(DEPTH, color, T, unit_m, LIMITS_M).register(depth)


def plane_mm(
    camera: CameraModel, normal: NDArray[np.float64], distance_m: float
) -> NDArray[np.float64]:
    """Depth of the points with ``normal . p = distance``, p in the camera's frame, at every
    pixel.
    """
    columns, rows = np.meshgrid(
        np.arange(camera.width, dtype=float), np.arange(camera.height, dtype=float)
    )
    rays = camera.rays(np.stack((columns.ravel(), rows.ravel()), axis=1))
    z = distance_m / (np.column_stack((rays, np.ones(len(rays)))) @ normal)
    return 1000.0 * z.reshape(camera.height, camera.width)


def aligned_by_librealsense(depth: NDArray[np.uint16], color: CameraModel) -> NDArray[np.uint16]:
    rs = import_realsense()
    software = SoftwareDevice(color, DEPTH, T_COLOR_DEPTH, 30)
    syncer = rs.syncer()
    sensors = software.device.query_sensors()
    for sensor in sensors:
        sensor.open(sensor.get_stream_profiles()[0])
        sensor.start(syncer)
    frames = None
    for number in range(1, 20):
        image = software.image("depth", depth, number * 33_000_000, number)
        software.give("depth", image, number * 33_000_000)
        blank = np.zeros((color.height, color.width, 3), np.uint8)
        software.give(
            "color",
            software.image("color", blank, number * 33_000_000, number),
            number * 33_000_000,
        )
        there, frames = syncer.try_wait_for_frames(1000)
        assert there
        if frames.size() == 2:
            break
    assert frames is not None and frames.size() == 2
    aligned = np.array(rs.align(rs.stream.color).process(frames).get_depth_frame().get_data())
    for sensor in sensors:
        sensor.stop()
        sensor.close()
    return aligned


def test_without_distortion_it_is_what_librealsense_does() -> None:
    scene = np.full((DEPTH.height, DEPTH.width), 2500, np.uint16)
    scene[60:160, 100:200] = 900
    scene[20:40, 20:60] = 0
    ours, theirs = registered(scene, PLAIN), aligned_by_librealsense(scene, PLAIN)
    both = (ours > 0) & (theirs > 0)
    assert both.mean() > 0.95
    # They draw an object up to a pixel larger than it is, so the outlines differ.
    assert (np.abs(ours.astype(int) - theirs)[both] <= 3).mean() > 0.985
    assert ((ours > 0) != (theirs > 0)).mean() < 0.02


def test_a_slanted_plane_is_where_the_calibration_says() -> None:
    normal_c = np.array([0.2, -0.35, 0.9]) / np.linalg.norm([0.2, -0.35, 0.9])
    normal_d = T_COLOR_DEPTH.R.T @ normal_c
    distance_d = 1.6 - float(normal_c @ T_COLOR_DEPTH.t)
    out = registered(np.round(plane_mm(DEPTH, normal_d, distance_d)).astype(np.uint16))
    expected = plane_mm(LENS, normal_c, 1.6)
    seen = out > 0
    assert seen[10:-10, 10:-10].all()
    assert np.abs(out - expected)[seen].max() < 9.0  # a pixel's step of that plane is up to 8 mm
    assert abs(float(np.mean((out - expected)[seen]))) < 1.0


def test_a_thing_near_the_corner_is_where_the_lens_draws_it() -> None:
    scene = np.zeros((DEPTH.height, DEPTH.width), np.uint16)
    scene[14:25, 20:31] = 800
    ray = np.array([*DEPTH.ray(25.0, 19.0), 1.0])
    x, y, z = (float(each) for each in T_COLOR_DEPTH.apply(0.8 * ray))
    expected = np.array(LENS.project_point((x, y, z)))
    rows, columns = np.nonzero(registered(scene))
    assert np.hypot(*(np.array([columns.mean(), rows.mean()]) - expected)) < 0.5
    # what leaving the lens out would do
    assert np.hypot(*(np.array(PLAIN.project_point((x, y, z))) - expected)) > 2.0


def test_what_is_nearer_hides_what_is_behind_it() -> None:
    T = Pose(np.eye(3), np.array([0.06, 0.0, 0.0]))  # far apart: both fall on the same pixels
    scene = np.full((DEPTH.height, DEPTH.width), 3000, np.uint16)
    scene[100:140, 140:180] = 700
    out = registered(scene, PLAIN, T=T)
    shift = PLAIN.fx * 0.06 / 0.7
    near = out[
        105:135, round(145 + shift + PLAIN.cx - DEPTH.cx) : round(175 + shift + PLAIN.cx - DEPTH.cx)
    ]
    assert set(near.ravel().tolist()) == {700}


def test_noise_leaves_no_gaps() -> None:
    rng = np.random.default_rng(1)
    z = 2.0 + 0.005 * 4.0 * rng.standard_normal((DEPTH.height, DEPTH.width))
    out = registered(np.round(1000.0 * z).astype(np.uint16))
    assert (out[10:-10, 10:-10] == 0).mean() < 0.001


@pytest.mark.parametrize(("z_mm", "kept"), [(299, False), (301, True), (5990, True), (6010, False)])
def test_limits_are_of_metres_whatever_the_unit(z_mm: int, kept: bool) -> None:
    for unit_m in (0.001, 0.0001):
        raw = round(z_mm * 0.001 / unit_m)
        scene = np.full((DEPTH.height, DEPTH.width), raw, np.uint16)
        out = registered(scene, unit_m=unit_m, T=Pose(np.eye(3), np.zeros(3)))
        assert bool(out.any()) == kept
        if kept:
            assert np.abs(out[out > 0].astype(int) - z_mm).max() <= 1


def test_streams_that_do_not_fit_are_refused() -> None:
    fine = CameraModel(1280, 960, 1230.0, 1230.0, 640.0, 480.0)
    with pytest.raises(ValueError, match="finer depth stream"):
        DepthRegistration(DEPTH, fine, T_COLOR_DEPTH, UNIT_M, LIMITS_M)
    with pytest.raises(ValueError, match="only rectified depth"):
        DepthRegistration(
            replace(DEPTH, distortion=LENS.distortion), LENS, T_COLOR_DEPTH, UNIT_M, LIMITS_M
        )
    backwards = Pose(np.diag([-1.0, 1.0, -1.0]), np.zeros(3))
    with pytest.raises(ValueError, match="different directions"):
        DepthRegistration(DEPTH, LENS, backwards, UNIT_M, LIMITS_M)
