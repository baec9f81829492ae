"""The prior in D2's image: the paper's own figure, covariance against sampling, and what is no
prior at all.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from path.camera.kernels import lens_of
from path.camera.model import CameraModel
from path.config import MethodConfig
from path.cycle.kernels import projected
from path.cycle.prior import TARGET_REACH_M, Prior, Ray, predict
from path.geometry.rigid import rigid, transform
from path.geometry.rotation import exp
from path.geometry.transforms import Matrix, Pose
from path.messages import Vec3
from path.observations import Missed, MissReason

CONFIG = MethodConfig()
NOMINAL = CameraModel(  # eq. nominal_intrinsics: 1920 x 1080, 69.4 by 42.5 degrees
    1920,
    1080,
    960.0 / math.tan(math.radians(34.7)),
    540.0 / math.tan(math.radians(21.25)),
    960.0,
    540.0,
)
NOMINAL_POSE = Pose(exp(np.array([0.0, math.radians(25.0), 0.0])), np.array([-1.0, 0.2, 1.0]))
CAMERA = CameraModel(640, 480, 615.0, 616.0, 320.0, 240.0, (-0.1, 0.05, 0.001, -0.001, 0.0))
POSE = Pose(exp(np.array([0.2, 0.4, -0.1])), np.array([-0.7, 0.1, 1.2]))
POINT = (0.3, -0.25, 1.4)


def covariance(t_sigma_m: float = 0.004, r_sigma_rad: float = 0.003) -> Matrix:
    """Translation and rotation correlated, as those of a planar marker are."""
    a = np.diag([t_sigma_m] * 3 + [r_sigma_rad] * 3)
    a[0, 4] = 0.6 * t_sigma_m
    a[1, 3] = -0.6 * t_sigma_m
    return a @ a.T


def propagate(
    covariance: Matrix,
    sigma_m: float,
    sigma_px: float,
    way_v: Vec3 = (0.0, 0.0, 1.0),
    across_m: float = -1.0,
) -> tuple[tuple[float, float, float], float]:
    """The covariance of the point's pixel, and the standard deviation of D2's position."""
    found = projected(
        lens_of(CAMERA), rigid(POSE), covariance, POINT, sigma_m, sigma_px, way_v, across_m
    )
    return found[3], found[4]


def prior_of(**changes: Any) -> Prior | Missed:
    values: dict[str, Any] = {
        "lens": lens_of(CAMERA),
        "T_c2_v": rigid(POSE),
        "covariance": covariance(),
        "point_v": POINT,
        "point_sigma_m": 0.01,
        "target_sequence": 7,
        "config": CONFIG,
    }
    return predict(**(values | changes))


def test_nominal_projection_of_the_paper() -> None:
    # the target at D1's principal point at 1 m, v and c1 taken as one frame, yaw about the camera's
    # y axis
    assert NOMINAL.fx == pytest.approx(1386.42, abs=0.01)
    assert NOMINAL.fy == pytest.approx(1388.61, abs=0.01)
    prior = predict(
        lens_of(NOMINAL), rigid(NOMINAL_POSE), covariance(), (0.0, 0.0, 1.0), 0.005, 0, CONFIG
    )
    assert isinstance(prior, Prior)
    assert prior.pixel == pytest.approx((540.08, 685.69), abs=0.01)


def test_nominal_geometry_could_not_see_the_marker() -> None:
    u, _ = NOMINAL.project_point(transform(rigid(NOMINAL_POSE), (0.0, 0.0, 0.0)))
    assert u == pytest.approx(-426.4, abs=0.1)


def perturbed(direction: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Pixel of the target and D2's position in ``v``: rotated from the left in the camera frame, t
    untouched.
    """
    R, t = exp(step * direction[3:]) @ POSE.R, POSE.t + step * direction[:3]
    x, y, z = (R @ np.array(POINT) + t).tolist()
    return np.array(CAMERA.project_point((x, y, z))), -R.T @ t


@given(st.lists(st.floats(-1.0, 1.0), min_size=6, max_size=6).map(np.array))
def test_covariance_follows_the_pose_in_every_direction(direction: np.ndarray) -> None:
    (u0v0, p0), (u1v1, p1) = perturbed(direction, -1e-6), perturbed(direction, 1e-6)
    du, dv = (u1v1 - u0v0) / 2e-6
    moved = np.linalg.norm((p1 - p0) / 2e-6)
    (uu, uv, vv), sigma_m = propagate(np.outer(direction, direction), 0.0, 0.0)
    assert (uu, uv, vv) == pytest.approx((du * du, du * dv, dv * dv), rel=1e-5, abs=1e-3)
    assert sigma_m == pytest.approx(moved / math.sqrt(3.0), rel=1e-5, abs=1e-7)


def test_covariance_of_point_and_detector_adds_up() -> None:
    (uu, uv, vv), sigma_m = propagate(np.zeros((6, 6)), 0.01, 1.5)
    point_c = transform(rigid(POSE), POINT)
    J = CAMERA.jacobian(np.array([point_c]))[0]
    np.testing.assert_allclose([[uu, uv], [uv, vv]], 1e-4 * J @ J.T + 2.25 * np.eye(2))
    assert sigma_m == 0.0


def test_region_reaches_the_ellipse_and_half_the_targets_box() -> None:
    prior, with_box = prior_of(), prior_of(box_size_at_1m_px=(200.0, 100.0))
    assert isinstance(prior, Prior)
    assert isinstance(with_box, Prior)
    u, v = prior.pixel
    edge_u, edge_v = prior.region.x1 - u, prior.region.y1 - v
    assert edge_u == pytest.approx(CONFIG.search_sigmas * math.sqrt(prior.covariance_px2[0]))
    assert edge_v == pytest.approx(CONFIG.search_sigmas * math.sqrt(prior.covariance_px2[2]))
    assert with_box.region.x1 - prior.region.x1 == pytest.approx(100.0 / prior.depth_m)
    assert with_box.region.y1 - prior.region.y1 == pytest.approx(50.0 / prior.depth_m)


def test_region_is_never_smaller_than_the_least() -> None:
    config = replace(CONFIG, min_search_px=120.0)
    prior = prior_of(config=config)
    assert isinstance(prior, Prior)
    assert prior.region.x1 - prior.pixel[0] == pytest.approx(120.0)


def test_distance_is_in_standard_deviations() -> None:
    prior = prior_of()
    assert isinstance(prior, Prior)
    u, v = prior.pixel
    precision = np.linalg.inv([prior.covariance_px2[:2], prior.covariance_px2[1:]])
    offset = np.array([7.0, -4.0])
    assert prior.distance2(u + 7.0, v - 4.0) == pytest.approx(offset @ precision @ offset)
    assert prior.distance2(u, v) == 0.0


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"point_v": (5.0, 0.0, 1.0)}, MissReason.PRIOR_OUTSIDE),
        ({"point_v": (0.0, 0.0, -3.0)}, MissReason.PRIOR_OUTSIDE),
        ({"point_v": (math.nan, 0.0, 1.0)}, MissReason.NON_FINITE),
        ({"point_sigma_m": math.inf}, MissReason.NON_FINITE),
        ({"covariance": np.full((6, 6), np.nan)}, MissReason.NON_FINITE),
        ({"covariance": covariance(t_sigma_m=0.2)}, MissReason.POSE_UNCERTAIN),
        ({"point_sigma_m": 0.5}, MissReason.POSE_UNCERTAIN),
    ],
)
def test_what_is_no_prior_says_why(changes: dict[str, Any], reason: MissReason) -> None:
    result = prior_of(**changes)
    assert isinstance(result, Missed)
    assert result.reason is reason


@given(st.lists(st.floats(-1.0, 1.0), min_size=6, max_size=6).map(np.array))
def test_depth_has_the_covariance_of_the_pose(direction: np.ndarray) -> None:
    before, after = (
        (exp(step * direction[3:]) @ POSE.R @ np.array(POINT) + POSE.t + step * direction[:3])[2]
        for step in (-1e-6, 1e-6)
    )
    pose = np.outer(direction, direction)
    sigma_m = projected(lens_of(CAMERA), rigid(POSE), pose, POINT, 0.0, 0.0, (0.0, 0.0, 1.0), -1.0)[
        5
    ]
    assert sigma_m == pytest.approx(abs(after - before) / 2e-6, abs=1e-6)


def test_the_region_reaches_as_far_away_as_the_target_can_be() -> None:
    prior = prior_of()
    assert isinstance(prior, Prior)
    near_m, far_m = prior.region.near_m, prior.region.far_m
    assert prior.depth_m - near_m == pytest.approx(far_m - prior.depth_m)
    assert far_m - prior.depth_m > TARGET_REACH_M + CONFIG.search_sigmas * 0.01
    wide = prior_of(point_sigma_m=0.05)
    assert isinstance(wide, Prior)
    assert wide.region.far_m > far_m + CONFIG.search_sigmas * 0.03
    assert not wide.region.any_depth


# --- a range that is worse than the bearing


def test_a_range_error_moves_the_prior_along_the_line_of_sight_only() -> None:
    direction = np.array([0.8, -0.1, 0.6])
    direction /= np.linalg.norm(direction)
    way_v, pose = (
        (float(direction[0]), float(direction[1]), float(direction[2])),
        covariance(1e-9, 1e-9),
    )
    (uu, uv, vv), _ = propagate(pose, 0.02, 0.0, way_v, 0.005)
    rng = np.random.default_rng(5)
    along, across = rng.normal(0.0, 0.02, 40_000), rng.normal(0.0, 0.005, (40_000, 3))
    across -= np.outer(across @ direction, direction)
    points = np.array(POINT) + np.outer(along, direction) + across
    pixels = CAMERA.project(POSE.apply(points))
    sampled = np.cov(pixels.T)
    assert (uu, uv, vv) == pytest.approx((sampled[0, 0], sampled[0, 1], sampled[1, 1]), rel=0.05)
    (even_uu, _, even_vv), _ = propagate(pose, 0.02, 0.0)
    assert uu * vv - uv * uv < 0.3 * even_uu * even_vv


@pytest.mark.parametrize("across_m", [0.0, 0.005])
@pytest.mark.parametrize("point_v", [POINT, (0.6, 0.3, 1.1), (-0.2, -0.5, 1.8)])
def test_along_and_across_the_line_of_sight_errors_are_those_of_the_projection(
    point_v: Vec3, across_m: float
) -> None:
    """To first order exactly: ``J (across² I + (along² - across²) w wᵀ) Jᵀ`` with ``w`` in the
    camera's frame.
    """
    way = np.array([0.48, -0.6, 0.64])
    way_v = (0.48, -0.6, 0.64)
    point_c = transform(rigid(POSE), point_v)
    J = CAMERA.jacobian(np.array([point_c]))[0]
    along_c = POSE.R @ way
    spread = across_m**2 * np.eye(3) + (0.02**2 - across_m**2) * np.outer(along_c, along_c)
    found = projected(
        lens_of(CAMERA), rigid(POSE), np.zeros((6, 6)), point_v, 0.02, 0.0, way_v, across_m
    )
    expected = J @ spread @ J.T
    uu, uv, vv = found[3]
    assert (uu, uv, vv) == pytest.approx((expected[0, 0], expected[0, 1], expected[1, 1]), rel=1e-6)


def test_across_it_the_target_is_never_less_certain_than_along_it() -> None:
    far_off = prior_of(ray=Ray((0.0, 0.0, 1.0), 5.0))
    plain = prior_of()
    assert isinstance(far_off, Prior)
    assert isinstance(plain, Prior)
    assert far_off.covariance_px2 == pytest.approx(plain.covariance_px2)


# --- what D2's camera sees, to the edge

SQUARE = CameraModel(640, 480, 128.0, 128.0, 0.0, 0.0)
STRAIGHT = rigid(Pose(np.eye(3), np.zeros(3)))


def is_seen(point_v: Vec3, max_radius: float = 9.0) -> bool:
    """By a camera in the marker's own frame, whose principal point is its first pixel."""
    lens = lens_of(SQUARE).copy()
    lens[11] = max_radius
    found = projected(lens, STRAIGHT, covariance(), point_v, 0.01, 1.0, (0.0, 0.0, 1.0), -1.0)
    assert found[2] == point_v[2]
    return not math.isnan(found[0])


@pytest.mark.parametrize("axis", [0, 1])
def test_the_image_reaches_from_half_a_pixel_before_the_first_to_half_a_pixel_before_its_end(
    axis: int,
) -> None:
    def at(pixel: float) -> Vec3:
        along = pixel / 128.0
        return (along, 0.1, 1.0) if axis == 0 else (0.1, along, 1.0)

    end = (640.0, 480.0)[axis] - 0.5
    assert is_seen(at(-0.5)) and is_seen(at(end - 0.001))
    assert not is_seen(at(-0.501)) and not is_seen(at(end))


def test_the_lens_sees_to_its_own_bound_and_nothing_behind_it() -> None:
    assert is_seen((0.5, 0.0, 1.0), max_radius=0.5) and is_seen((0.0, 0.5, 1.0), max_radius=0.5)
    assert is_seen((0.25, 0.0, 0.5), max_radius=0.5)
    assert not is_seen((0.501, 0.0, 1.0), max_radius=0.5) and not is_seen(
        (0.0, 0.501, 1.0), max_radius=0.5
    )
    assert not is_seen((0.4, 0.4, 1.0), max_radius=0.5)
    assert not is_seen((-0.1, -0.1, -1.0))  # its picture would fall inside the image
    assert not is_seen((0.0, 0.0, -1.0))


def test_at_its_limits_a_prior_is_still_one() -> None:
    prior = prior_of()
    assert isinstance(prior, Prior)
    half_px = CONFIG.search_sigmas * math.sqrt(
        max(prior.covariance_px2[0], prior.covariance_px2[2])
    )
    at_limits = replace(CONFIG, max_pose_sigma_m=prior.pose_sigma_m, max_search_px=half_px)
    assert prior_of(config=at_limits) == prior
    for tighter in (
        {"max_pose_sigma_m": 0.999 * prior.pose_sigma_m},
        {"max_search_px": 0.999 * half_px},
    ):
        assert prior_of(config=replace(at_limits, **tighter)) == Missed(MissReason.POSE_UNCERTAIN)


def test_a_covariance_that_is_none_is_no_number() -> None:
    """One with a negative variance has no ellipse, and one of nothing at all has no room in it."""
    negative = np.diag([-1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert prior_of(covariance=negative) == Missed(MissReason.NON_FINITE)
    exact = replace(CONFIG, pixel_sigma_px=0.0, target_center_sigma_m=0.0)
    nothing = np.zeros((6, 6))
    assert prior_of(covariance=nothing, point_sigma_m=0.0, config=exact) == Missed(
        MissReason.NON_FINITE
    )


def test_the_region_reaches_a_body_s_depth_further_than_the_uncertainty() -> None:
    exact = prior_of(covariance=covariance(1e-9, 1e-9), point_sigma_m=0.0)
    assert isinstance(exact, Prior)
    assert exact.region.far_m - exact.depth_m == pytest.approx(0.3, abs=1e-6)
    near = prior_of(
        lens=lens_of(SQUARE), T_c2_v=STRAIGHT, point_v=(0.02, 0.02, 0.2), point_sigma_m=0.0
    )
    assert isinstance(near, Prior)
    assert near.region.near_m == 0.0  # nothing is behind the camera


def test_the_height_of_the_search_has_a_least_too() -> None:
    prior = prior_of(config=replace(CONFIG, min_search_px=120.0))
    assert isinstance(prior, Prior)
    assert prior.region.y1 - prior.pixel[1] == pytest.approx(120.0)
    assert prior.pixel[1] - prior.region.y0 == pytest.approx(120.0)


def test_a_covariance_in_any_order_of_memory_is_taken_without_compiling_anew() -> None:
    turned = np.asfortranarray(covariance())
    assert prior_of(covariance=turned) == prior_of()
    assert len(projected.signatures) == 1


def test_the_region_says_how_large_the_target_is_expected() -> None:
    with_box = prior_of(box_size_at_1m_px=(200.0, 100.0))
    body = replace(CONFIG, evidence=replace(CONFIG.evidence, span_m=0.77, height_m=1.75))
    by_body = prior_of(config=body)
    assert isinstance(with_box, Prior)
    assert isinstance(by_body, Prior)
    assert with_box.region.side_px == pytest.approx(200.0 / with_box.depth_m)
    assert by_body.region.side_px == pytest.approx(1.75 * CAMERA.fx / by_body.depth_m)
