"""The pose with gravity: the right one of two solutions, and a covariance that holds."""

from __future__ import annotations

import dataclasses
import math
import subprocess
import sys

import numpy as np
import pytest
from numpy.typing import NDArray

from path.camera.kernels import lens_of
from path.camera.model import CameraModel, Nine
from path.geometry import rotation
from path.geometry.transforms import Pose
from path.marker.detect import detect_markers
from path.marker.layout import Marker, MarkerLayout, single_marker
from path.marker.pose import MarkerPose, PoseSettings, _ippe, estimate_pose
from path.marker.warm_up import warm_up
from path.messages import Vec3
from path.observations import MarkerDetection, Missed, MissReason
from tests.path.marker.scene import (
    HD,
    VGA,
    View,
    random_view,
    region_around,
    render,
    tilted,
    true_corners,
)

LAYOUT = single_marker(side_sigma_m=0.0)
ATTITUDE_RAD = math.radians(0.5)
SETTINGS = PoseSettings(ATTITUDE_RAD, ATTITUDE_RAD, focal_sigma=0.0, shape_sigma=0.0)
HERE = Pose(np.eye(3), np.zeros(3))


def vec(direction: NDArray[np.float64]) -> Vec3:
    x, y, z = direction.tolist()
    return x, y, z


def seen(
    camera: CameraModel,
    view: View,
    sigma_px: float,
    rng: np.random.Generator,
    layout: MarkerLayout = LAYOUT,
) -> tuple[MarkerDetection, ...]:
    return tuple(
        MarkerDetection(
            marker.id,
            true_corners(camera, view.T_c_v, layout, marker.id) + rng.normal(0.0, sigma_px, (4, 2)),
            sigma_px**2 * np.eye(8),
        )
        for marker in layout.markers
    )


def solve(
    camera: CameraModel,
    view: View,
    detections: tuple[MarkerDetection, ...],
    rng: np.random.Generator,
    layout: MarkerLayout = LAYOUT,
    settings: PoseSettings = SETTINGS,
) -> MarkerPose | Missed:
    down_v, down_c = (vec(tilted(g, ATTITUDE_RAD, rng)) for g in (view.gravity_v, view.gravity_c))
    return estimate_pose(detections, layout, camera, down_v, down_c, settings)


def error(pose: MarkerPose, view: View) -> NDArray[np.float64]:
    """(dt, dw) of the pose's convention, shape (6,)."""
    return np.concatenate(
        [pose.T_c_v.t - view.T_c_v.t, rotation.log(pose.T_c_v.R @ view.T_c_v.R.T)]
    )


def turned_over(R: NDArray[np.float64], view: View) -> bool:
    return rotation.angle_between(R, view.T_c_v.R) > math.radians(10.0)


def surprise(pose: MarkerPose, view: View) -> float:
    e = error(pose, view)
    return float(e @ np.linalg.solve(pose.covariance, e)) / 6.0


def test_without_noise_the_pose_is_exact():
    rng = np.random.default_rng(0)
    for camera in (VGA, HD):
        for _ in range(20):
            view = random_view(rng, camera, 0.4, 2.0, 60.0)
            corners = true_corners(camera, view.T_c_v, LAYOUT)
            detection = MarkerDetection(0, corners, 1e-4 * np.eye(8))
            pose = estimate_pose(
                (detection,), LAYOUT, camera, vec(view.gravity_v), vec(view.gravity_c), SETTINGS
            )
            assert isinstance(pose, MarkerPose)
            assert np.abs(error(pose, view)).max() < 1e-6


@pytest.mark.parametrize("sigma_px", [0.1, 0.3])
def test_gravity_ends_flips(sigma_px: float):
    """Corners as good as cv2's: the first planar solution turns over, the pose with gravity
    never.
    """
    rng = np.random.default_rng(1)
    first_flips, flips, tries = 0, 0, 300
    for _ in range(tries):
        view = random_view(rng, VGA, 0.7, 1.5, 60.0)
        detections = seen(VGA, view, sigma_px, rng)
        first_flips += turned_over(
            _ippe(detections[0], LAYOUT.markers[0], lens_of(VGA))[0][0], view
        )
        pose = solve(VGA, view, detections, rng)
        assert isinstance(pose, MarkerPose)
        flips += turned_over(pose.T_c_v.R, view)
    assert flips == 0
    assert first_flips > 0.05 * tries


@pytest.mark.parametrize("sigma_px", [0.02, 0.1, 0.4])
@pytest.mark.parametrize("camera", [VGA, HD])
def test_the_covariance_holds(camera: CameraModel, sigma_px: float):
    rng = np.random.default_rng(2)
    surprises = list[float]()
    for _ in range(150):
        view = random_view(rng, camera, 0.7, 1.5, 60.0)
        pose = solve(camera, view, seen(camera, view, sigma_px, rng), rng)
        assert isinstance(pose, MarkerPose)
        surprises.append(surprise(pose, view))
    assert 0.75 < np.mean(surprises) < 1.25


@pytest.mark.parametrize("sigma_px", [0.015, 0.3])
@pytest.mark.parametrize(("sigma_v_deg", "sigma_c_deg"), [(1.2, 0.2), (0.1, 0.6)])
def test_the_squared_error_of_six_numbers_is_six_with_every_stated_error(
    sigma_px: float, sigma_v_deg: float, sigma_c_deg: float
):
    """Corner noise, print, focal length and two attitudes of different quality: normalised squared
    errors (NEES).
    """
    rng = np.random.default_rng(3)
    layout, sigma_v, sigma_c = (
        single_marker(side_sigma_m=0.0002),
        math.radians(sigma_v_deg),
        math.radians(sigma_c_deg),
    )
    settings = PoseSettings(sigma_v, sigma_c, focal_sigma=0.002, shape_sigma=0.0)
    squared = list[float]()
    for _ in range(400):
        view = random_view(rng, VGA, 0.7, 1.5, 60.0)
        printed = single_marker(side_m=0.04 + rng.normal(0.0, 0.0002))
        focal = 1.0 + rng.normal(0.0, 0.002)
        lens = dataclasses.replace(VGA, fx=VGA.fx * focal, fy=VGA.fy * focal)
        down_v, down_c = (
            vec(tilted(view.gravity_v, sigma_v, rng)),
            vec(tilted(view.gravity_c, sigma_c, rng)),
        )
        pose = estimate_pose(
            seen(lens, view, sigma_px, rng, printed), layout, VGA, down_v, down_c, settings
        )
        assert isinstance(pose, MarkerPose)
        squared.append(6.0 * surprise(pose, view))
    assert 5.4 < np.mean(squared) < 6.8  # its own standard deviation is 0.17
    assert 10.5 < np.percentile(squared, 95.0) < 15.0  # 12.6 with six degrees of freedom


@pytest.mark.parametrize("sigma_px", [0.02, 0.2])
def test_what_a_weak_calibration_does_not_know_is_in_the_covariance(sigma_px: float):
    """The camera that takes the image is off from the believed one by what its calibration states,
    all together.
    """
    doubts: tuple[Nine, ...] = (
        (14.0, 11.0, 0.0, 2.0, 0.02, -0.05, 0.0, 0.0, 0.06),
        (0.0, 5.0, 6.0, 0.0, -0.02, 0.1, 0.001, 0.0, -0.2),
        (0.0, 0.0, 2.0, -7.0, 0.0, 0.0, 0.0, 0.002, 0.0),
    )
    rng = np.random.default_rng(17)
    believed = dataclasses.replace(VGA, doubts=doubts)
    settings = PoseSettings(ATTITUDE_RAD, ATTITUDE_RAD, shape_sigma=0.0)
    squared = {True: list[float](), False: list[float]()}
    for _ in range(250):
        view = random_view(rng, VGA, 0.7, 1.5, 60.0)
        off = rng.standard_normal(3) @ np.array(doubts)
        k1, k2, p1, p2, k3 = (np.array(VGA.distortion) + off[4:]).tolist()
        true = dataclasses.replace(
            VGA, fx=VGA.fx + off[0], fy=VGA.fy + off[1], cx=VGA.cx + off[2], cy=VGA.cy + off[3],
            distortion=(k1, k2, p1, p2, k3),
        )  # fmt: skip
        detections = seen(true, view, sigma_px, rng)
        down_v, down_c = (
            vec(tilted(down, ATTITUDE_RAD, rng)) for down in (view.gravity_v, view.gravity_c)
        )
        for stated, camera in ((True, believed), (False, VGA)):
            pose = estimate_pose(detections, LAYOUT, camera, down_v, down_c, settings)
            assert isinstance(pose, MarkerPose)
            squared[stated].append(6.0 * surprise(pose, view))
    assert 5.2 < np.mean(squared[True]) < 7.0
    assert np.mean(squared[False]) > 2.0 * np.mean(squared[True])


def test_an_image_too_wide_or_skewed_is_in_the_covariance():
    """As stretched paper makes it, and rows that are read one after another: no residual of four
    corners shows it.
    """
    rng = np.random.default_rng(18)
    plain = dataclasses.replace(SETTINGS, max_ambiguity=1.0)
    believing = dataclasses.replace(plain, shape_sigma=0.003)
    surprises = {True: list[float](), False: list[float]()}
    for _ in range(200):
        view = random_view(rng, HD, 0.7, 1.5, 60.0)
        (found,) = seen(HD, view, 0.02, rng)
        p, q = rng.normal(0.0, 0.003, 2)
        off = (found.corners_px - found.corners_px.mean(axis=0)) @ np.array([[p, q], [q, -p]])
        shown = dataclasses.replace(found, corners_px=found.corners_px + off)
        down_v, down_c = (
            vec(tilted(down, ATTITUDE_RAD, rng)) for down in (view.gravity_v, view.gravity_c)
        )
        for stated, settings in ((True, believing), (False, plain)):
            pose = estimate_pose((shown,), LAYOUT, HD, down_v, down_c, settings)
            assert isinstance(pose, MarkerPose)
            surprises[stated].append(surprise(pose, view))
    assert 0.75 < np.mean(surprises[True]) < 1.25
    assert np.mean(surprises[False]) > 1.8


def test_an_attitude_that_is_less_sure_counts_for_less():
    rng = np.random.default_rng(12)
    view = random_view(rng, VGA, 1.0, 1.2, 30.0)
    detections = seen(VGA, view, 0.2, rng)
    spread = list[float]()
    for sigma_v, sigma_c in ((0.001, 0.001), (0.001, 0.02), (0.02, 0.001), (0.02, 0.02)):
        settings = PoseSettings(sigma_v, sigma_c, focal_sigma=0.0, shape_sigma=0.0)
        pose = estimate_pose(
            detections, LAYOUT, VGA, vec(view.gravity_v), vec(view.gravity_c), settings
        )
        assert isinstance(pose, MarkerPose)
        spread.append(float(np.trace(pose.covariance[3:, 3:])))
    assert spread[0] < 0.5 * spread[1] < 0.5 * spread[3]
    assert spread[1] == pytest.approx(spread[2], rel=0.01)


def test_one_gravity_alone_says_nothing():
    rng = np.random.default_rng(13)
    view = random_view(rng, VGA, 0.7, 0.8, 30.0)
    detections = seen(VGA, view, 0.02, rng)
    settings = dataclasses.replace(SETTINGS, max_ambiguity=1.0)
    poses = [
        estimate_pose(detections, LAYOUT, VGA, down_v, down_c, settings)
        for down_v, down_c in (
            (None, None),
            (vec(view.gravity_v), None),
            (None, vec(view.gravity_c)),
        )
    ]
    for pose in poses:
        assert isinstance(pose, MarkerPose) and isinstance(poses[0], MarkerPose)
        assert (pose.T_c_v.R == poses[0].T_c_v.R).all() and (
            pose.covariance == poses[0].covariance
        ).all()


def test_both_solutions_are_given_the_right_one_first():
    rng = np.random.default_rng(14)
    both, tries = 0, 100
    for _ in range(tries):
        view = random_view(rng, VGA, 0.7, 1.5, 60.0)
        pose = solve(VGA, view, seen(VGA, view, 0.3, rng), rng)
        assert isinstance(pose, MarkerPose)
        best, *others = pose.candidates
        assert best.T_c_v is pose.T_c_v and best.likelihood == 1.0
        assert len(others) <= 1
        for other in others:
            both += 1
            assert other.cost > best.cost and other.likelihood < 0.01
            assert rotation.angle_between(other.T_c_v.R, best.T_c_v.R) > 0.05
    assert both > 0.85 * tries


def test_the_likelihood_of_the_other_solution_is_how_often_it_is_the_right_one():
    """Without gravity, and the likelier one always taken."""
    rng = np.random.default_rng(15)
    settings = dataclasses.replace(SETTINGS, max_ambiguity=1.0)
    claimed, wrong = list[float](), list[bool]()
    for _ in range(400):
        view = random_view(rng, VGA, 0.7, 1.5, 60.0)
        pose = estimate_pose(seen(VGA, view, 0.15, rng), LAYOUT, VGA, None, None, settings)
        if isinstance(pose, MarkerPose) and len(pose.candidates) == 2:
            best, other = pose.candidates
            assert pose.ambiguity == other.likelihood
            claimed.append(other.likelihood / (1.0 + other.likelihood))
            to_best, to_other = (
                rotation.angle_between(c.T_c_v.R, view.T_c_v.R) for c in (best, other)
            )
            wrong.append(to_other < to_best)
    assert len(wrong) > 300 and np.mean(wrong) > 0.05
    assert np.mean(claimed) == pytest.approx(np.mean(wrong), abs=0.04)


def test_without_gravity_two_solutions_that_cannot_be_told_apart_are_not_believed():
    rng = np.random.default_rng(4)
    believed = flips = refused = 0
    for _ in range(200):
        view = random_view(rng, VGA, 0.7, 1.5, 60.0)
        pose = estimate_pose(seen(VGA, view, 0.2, rng), LAYOUT, VGA, None, None, SETTINGS)
        if isinstance(pose, MarkerPose):
            assert pose.ambiguity < 0.011
            believed, flips = believed + 1, flips + turned_over(pose.T_c_v.R, view)
        else:
            assert pose.reason is MissReason.POSE_UNCERTAIN
            refused += 1
    assert refused > 20 and believed > 20
    assert flips <= 0.03 * believed


def test_corners_that_fit_worse_than_they_claim_widen_the_covariance():
    rng = np.random.default_rng(5)
    view = random_view(rng, VGA, 0.7, 0.9, 30.0)
    (found,) = seen(VGA, view, 0.02, rng)
    skewed = found.corners_px + np.array([[0.3, 0.0], [-0.3, 0.0], [0.3, 0.0], [-0.3, 0.0]])
    good = solve(VGA, view, (found,), rng)
    bad = solve(VGA, view, (dataclasses.replace(found, corners_px=skewed),), rng)
    assert isinstance(good, MarkerPose) and isinstance(bad, MarkerPose)
    assert np.trace(bad.covariance[:3, :3]) > 4.0 * np.trace(good.covariance[:3, :3])
    assert bad.rms > 3.0 * good.rms
    folded = found.corners_px[[0, 2, 1, 3]]
    missed = solve(VGA, view, (dataclasses.replace(found, corners_px=folded),), rng)
    assert isinstance(missed, Missed)


def test_several_markers_make_one_pose_and_need_no_gravity():
    """A pair at an angle, as on a bent plate, and one of another size."""
    tilt = rotation.exp(np.array([0.0, math.radians(50.0), 0.0]))
    layout = MarkerLayout(
        (
            Marker(0, 0.04, 0.0, HERE),
            Marker(1, 0.04, 0.0, Pose(tilt, np.array([0.05, 0.0, -0.01]))),
            Marker(2, 0.03, 0.0, Pose(np.eye(3), np.array([0.0, 0.06, 0.0]))),
        )
    )
    rng = np.random.default_rng(6)
    one, many, surprises = list[float](), list[float](), list[float]()
    for _ in range(80):
        view = random_view(rng, VGA, 0.7, 1.5, 35.0)
        detections = seen(VGA, view, 0.1, rng, layout)
        alone = solve(VGA, view, detections[:1], rng, layout)
        pose = estimate_pose(detections, layout, VGA, None, None, SETTINGS)
        assert isinstance(pose, MarkerPose) and isinstance(alone, MarkerPose)
        one.append(float(np.linalg.norm(error(alone, view)[:3])))
        many.append(float(np.linalg.norm(error(pose, view)[:3])))
        surprises.append(surprise(pose, view))
        assert not turned_over(pose.T_c_v.R, view)
    assert np.mean(many) < 0.7 * np.mean(one)
    assert 0.7 < np.mean(surprises) < 1.3


def test_only_another_marker_of_the_layout_in_view_gives_the_pose_of_the_layout():
    layout = MarkerLayout(
        (
            Marker(0, 0.04, 0.0, HERE),
            Marker(1, 0.06, 0.0, Pose(np.eye(3), np.array([0.1, 0.0, 0.0]))),
        )
    )
    rng = np.random.default_rng(7)
    view = random_view(rng, VGA, 0.8, 1.0, 40.0)
    pose = solve(VGA, view, seen(VGA, view, 0.02, rng, layout)[1:], rng, layout)
    assert isinstance(pose, MarkerPose)
    assert np.abs(error(pose, view)[:3]).max() < 0.02


def test_every_miss_has_its_reason():
    rng = np.random.default_rng(8)
    view = random_view(rng, VGA, 0.7, 0.9, 30.0)
    (found,) = seen(VGA, view, 0.02, rng)

    def reason(*detections: MarkerDetection, **changed: float) -> MissReason | None:
        pose = solve(VGA, view, detections, rng, settings=dataclasses.replace(SETTINGS, **changed))
        return pose.reason if isinstance(pose, Missed) else None

    assert reason(found) is None
    assert reason() is MissReason.NO_MARKER
    assert reason(dataclasses.replace(found, marker_id=9)) is MissReason.WRONG_MARKER
    assert reason(found, found) is MissReason.MARKER_TWICE
    assert reason(found, max_incidence_rad=0.01) is MissReason.MARKER_OBLIQUE
    assert reason(found, max_sigma_m=1e-5) is MissReason.POSE_UNCERTAIN
    assert (
        reason(dataclasses.replace(found, corners_px=np.full((4, 2), np.nan)))
        is MissReason.NON_FINITE
    )


def test_incidence_and_size_are_those_of_the_view():
    rng = np.random.default_rng(9)
    T_c_v = Pose(
        rotation.exp(np.array([math.pi - math.radians(75.0), 0.0, 0.0])), np.array([0.0, 0.0, 0.8])
    )
    down_v, down_c = np.array([0.0, -1.0, 0.0]), T_c_v.R @ np.array([0.0, -1.0, 0.0])
    view = View(T_c_v, down_v, down_c)
    missed = solve(VGA, view, seen(VGA, view, 0.02, rng), rng)
    assert missed == Missed(MissReason.MARKER_OBLIQUE)
    pose = solve(
        VGA,
        view,
        seen(VGA, view, 0.02, rng),
        rng,
        settings=dataclasses.replace(SETTINGS, max_incidence_rad=1.4),
    )
    assert isinstance(pose, MarkerPose)
    assert pose.incidence_rad == pytest.approx(math.radians(75.0), abs=0.02)


@pytest.mark.parametrize(("camera", "mean_mm"), [(VGA, 4.5), (HD, 3.0)])
def test_from_the_image_to_the_pose(camera: CameraModel, mean_mm: float):
    """The whole way, one frame, attitude errors on: D2's position in ``v``."""
    rng = np.random.default_rng(10)
    errors, surprises = list[float](), list[float]()
    ground = np.full((camera.height, camera.width), 105.0)
    for _ in range(25):
        view = random_view(rng, camera, 0.7, 1.4, 50.0)
        image = render(camera, view.T_c_v, LAYOUT, rng, ground=ground)
        region = region_around(true_corners(camera, view.T_c_v, LAYOUT), 60.0)
        pose = solve(camera, view, detect_markers(image, region, LAYOUT, camera), rng)
        assert isinstance(pose, MarkerPose)
        errors.append(1e3 * float(np.linalg.norm(pose.T_c_v.inverse().t - view.T_c_v.inverse().t)))
        surprises.append(surprise(pose, view))
    assert np.mean(errors) < mean_mm
    assert np.mean(surprises) < 1.6


def test_warming_up_finds_its_own_marker():
    warm_up()


def test_a_first_shadow_in_flight_finds_its_kernels_compiled() -> None:
    asked = "from path.marker import warm_up; from path.marker.photometric import shadow; warm_up.warm_up(); "
    asked += "assert shadow.cell_light.signatures and shadow.find_shadow.signatures"
    subprocess.run([sys.executable, "-c", asked], check=True, timeout=600.0)
