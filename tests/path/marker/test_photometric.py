"""The photometric fit against exact images: bias, noise, claimed covariance, model mismatch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from path.camera.model import CameraModel, sensor_of
from path.camera.thinning import Thinning
from path.geometry import rotation
from path.geometry.transforms import Pose
from path.marker.layout import single_marker
from path.marker.photometric.corners import PhotometricFit, fit
from path.marker.photometric.misfit import COARSE, FILTERED, SHADOWED, TAPS, model
from path.marker.photometric.pattern import UNKNOWNS
from path.marker.photometric.texture import cells
from tests.path.marker.scene import (
    HD,
    VGA,
    Optics,
    random_view,
    region_around,
    render,
    true_corners,
)

LAYOUT = single_marker()
CELLS = np.pad(cells("DICT_4X4_50", 0), 1, constant_values=1.0)
THINNED = Thinning(3, 5, (1, 2))
STRAIGHT = CameraModel(110, 110, 600.0, 600.0, 55.0, 55.0)  # no distortion


@dataclass(frozen=True)
class Sample:
    error_px: NDArray[np.float64]  # (4, 2)
    radial_px: float
    fitted: PhotometricFit

    @property
    def surprise(self) -> float:
        """Squared error in units of the claimed covariance, 1 when that is right."""
        e = self.error_px.ravel()
        return float(e @ np.linalg.solve(self.fitted.covariance_px2, e)) / 8.0


def sample(
    camera: CameraModel, seed: int, optics: Optics, start_px: float = 0.4, far_m: float = 1.5
) -> Sample:
    rng = np.random.default_rng(seed)
    view = random_view(rng, camera, 0.7, far_m, 50.0)
    truth = true_corners(camera, view.T_c_v, LAYOUT)
    ground = np.full((camera.height, camera.width), 105.0)
    image = render(camera, view.T_c_v, LAYOUT, rng, optics, ground)
    region = region_around(truth, 50.0)
    u0, v0 = int(region.x0), int(region.y0)
    crop = np.ascontiguousarray(image[v0 : v0 + 100, u0 : u0 + 100])
    fitted = fit(crop, (u0, v0), truth + rng.uniform(-start_px, start_px, (4, 2)), camera, CELLS)
    assert fitted is not None
    error = fitted.corners_px - truth
    out = truth - truth.mean(axis=0)
    return Sample(error, float((error * out).sum() / np.hypot(*out.T).sum()), fitted)


def rms(samples: list[Sample]) -> float:
    return float(np.sqrt(np.mean([s.error_px**2 for s in samples])))


def test_without_noise_the_model_is_exact_to_a_hundredth_of_a_pixel():
    found = [sample(VGA, seed, Optics(noise=0.0, samples=16)) for seed in range(8)]
    assert rms(found) < 0.01
    assert all(
        s.fitted.blur_px == pytest.approx(np.hypot(0.7, np.sqrt(1 / 12)), abs=0.06) for s in found
    )


def test_pixels_that_a_camera_leaves_out_are_reckoned_with():
    """Corners are as good as those of an even image; without the pattern they are off by what the
    pixels are.
    """
    thinned = replace(VGA, thinning=THINNED)
    sensor = sensor_of(thinned)
    columns, rows = (
        THINNED.sensor_pixels(n, axis) for axis, n in enumerate((VGA.width, VGA.height))
    )
    errors: dict[CameraModel, list[NDArray[np.float64]]] = {thinned: [], VGA: []}
    for seed in range(12):
        rng = np.random.default_rng(seed)
        view = random_view(rng, VGA, 0.7, 1.2, 50.0)
        ground = np.full((sensor.height, sensor.width), 105.0)
        image = render(sensor, view.T_c_v, LAYOUT, rng, Optics(), ground)[np.ix_(rows, columns)]
        truth = true_corners(VGA, view.T_c_v, LAYOUT)
        for camera, off in errors.items():
            fitted = fit(
                np.ascontiguousarray(image),
                (0, 0),
                truth + rng.uniform(-0.4, 0.4, (4, 2)),
                camera,
                CELLS,
            )
            assert fitted is not None
            off.append(fitted.corners_px - truth)
    even, uneven = (float(np.sqrt(np.mean(np.square(off)))) for off in errors.values())
    assert even < 0.03
    assert uneven > 2.0 * even


@pytest.mark.parametrize(("camera", "limit_px"), [(VGA, 0.02), (HD, 0.015)])
def test_corners_are_accurate_and_know_how_much(camera: CameraModel, limit_px: float):
    found = [sample(camera, seed, Optics()) for seed in range(30)]
    assert rms(found) < limit_px
    assert abs(np.mean([s.radial_px for s in found])) < 0.006
    assert 0.4 < np.mean([s.surprise for s in found]) < 1.5


@pytest.mark.parametrize(
    ("optics", "limit_px"),
    [
        (Optics(gamma=2.2, black=10.0, white=180.0), 0.04),
        (Optics(white=330.0), 0.04),  # the white is as bright as a pixel can be
        (Optics(noise=8.0), 0.09),
        (Optics(shade=0.25), 0.03),
    ],
)
def test_light_that_is_not_ideal_is_part_of_the_model_or_of_the_covariance(
    optics: Optics, limit_px: float
):
    found = [sample(VGA, seed, optics) for seed in range(20)]
    assert rms(found) < limit_px
    assert np.mean([s.surprise for s in found]) < 2.5


def test_what_the_model_does_not_know_makes_it_less_sure():
    plain = [sample(VGA, seed, Optics(noise=1.0)) for seed in range(10)]
    sharp = [sharpened(seed) for seed in range(10)]
    assert np.mean([s.surprise for s in sharp]) < 2.5
    assert np.sqrt(np.trace(sharp[0].fitted.covariance_px2)) > 2.0 * np.sqrt(
        np.trace(plain[0].fitted.covariance_px2)
    )


def sharpened(seed: int) -> Sample:
    rng = np.random.default_rng(seed)
    view = random_view(rng, VGA, 0.7, 1.5, 50.0)
    truth = true_corners(VGA, view.T_c_v, LAYOUT)
    image = render(
        VGA, view.T_c_v, LAYOUT, rng, Optics(noise=1.0), np.full((480, 640), 105.0)
    ).astype(np.float64)
    image = image + 1.5 * (image - cv2.GaussianBlur(image, (0, 0), 1.2))
    fitted = fit(np.clip(image, 0.0, 255.0).astype(np.uint8), (0, 0), truth.copy(), VGA, CELLS)
    assert fitted is not None
    return Sample(fitted.corners_px - truth, 0.0, fitted)


def test_the_start_does_not_matter_within_a_pixel():
    near, far = sample(VGA, 5, Optics(), 0.05), sample(VGA, 5, Optics(), 0.9)
    assert near.fitted.corners_px == pytest.approx(far.fitted.corners_px, abs=0.01)


def test_an_image_without_the_marker_gives_no_trustworthy_fit():
    rng = np.random.default_rng(2)
    start = np.array([[30.0, 30.0], [55.0, 32.0], [54.0, 58.0], [29.0, 55.0]])
    for image in (np.full((90, 90), 120, np.uint8), rng.integers(0, 255, (90, 90), dtype=np.uint8)):
        fitted = fit(image, (0, 0), start, VGA, CELLS)
        assert fitted is None or fitted.explained < 0.6 or fitted.contrast < 8.0


def test_corners_that_are_no_quadrilateral_give_no_fit():
    image = np.full((90, 90), 120, np.uint8)
    assert fit(image, (0, 0), np.full((4, 2), 40.0), VGA, CELLS) is None
    assert fit(image, (0, 0), np.full((4, 2), np.nan), VGA, CELLS) is None
    assert (
        fit(image, (0, 0), np.array([[300.0, 300], [330, 300], [330, 330], [300, 330]]), VGA, CELLS)
        is None
    )


def test_derivatives_are_those_of_the_grey_value():
    rng = np.random.default_rng(7)
    theta = np.array(
        [2.1, 0.3, 3.1, -0.2, 2.3, 2.8, 0.0, 0.0, 40.0, 3.0, -2.0, 150.0, 5.0, -4.0, 0.02, 0.2]
    )
    extra = np.concatenate([np.zeros(TAPS), rng.normal(0.0, 0.03, 10), [0.4, 0.7, 0.1, -1.0]])
    frame = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 11.0, 1.0, -2.0, 12.0])
    edges, groups = np.stack([np.arange(7.0)] * 2), np.array([True, True, True])
    rays = rng.uniform(-1.3, 1.3, (60, 2))

    def rows(of_theta: NDArray[np.float64], of_extra: NDArray[np.float64]) -> NDArray[np.float64]:
        return model(rays, of_theta, of_extra, groups, frame, CELLS, edges)

    slopes = rows(theta, extra)
    # of the homography a shift alone: the rest turns the blur too
    places = [(k, theta) for k in (2, 5, *range(8, UNKNOWNS))] + [
        (k, extra) for k in range(TAPS, len(extra))
    ]
    for k, of in places:
        h = np.zeros(len(of))
        h[k] = 1e-6 * max(1.0, abs(of[k]))
        more, less = (
            rows(theta + s * h, extra) if of is theta else rows(theta, extra + s * h)
            for s in (1.0, -1.0)
        )
        slope = (more[:, -1] - less[:, -1]) / (2.0 * h[k])
        own = slopes[:, k if of is theta else UNKNOWNS + k - TAPS]
        assert np.linalg.norm(own - slope) < 0.1 * np.linalg.norm(slope), (k, of is theta)


def test_motion_is_found_and_corners_stay_good_with_it_and_with_sharpening():
    def wrong(image: Callable[[NDArray[np.float64]], NDArray[np.float64]], seed: int) -> Sample:
        rng = np.random.default_rng(seed)
        view = random_view(rng, VGA, 0.6, 1.0, 40.0)
        truth = true_corners(VGA, view.T_c_v, LAYOUT)
        drawn = render(VGA, view.T_c_v, LAYOUT, rng, Optics(), np.full((480, 640), 105.0)).astype(
            np.float64
        )
        grey = np.clip(np.rint(image(drawn)), 0.0, 255.0).astype(np.uint8)
        fitted = fit(grey, (0, 0), truth + rng.uniform(-0.4, 0.4, (4, 2)), VGA, CELLS)
        assert fitted is not None
        return Sample(fitted.corners_px - truth, 0.0, fitted)

    def sharp(image: NDArray[np.float64]) -> NDArray[np.float64]:
        return image + 1.0 * (image - cv2.GaussianBlur(image, (0, 0), 1.1))

    def moved(image: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(cv2.blur(image, (3, 1)), dtype=np.float64)

    for change, limit_px, filtered in ((sharp, 0.04, False), (moved, 0.03, True)):
        found = [wrong(change, seed) for seed in range(10)]
        assert (np.mean([s.fitted.wrong[FILTERED] for s in found]) > 0.7) == filtered
        assert rms(found) < limit_px
        assert np.mean([s.surprise for s in found]) < 2.0


def test_the_edge_of_a_shadow_is_found():
    for seed in range(6):
        rng = np.random.default_rng(seed)
        view = random_view(rng, HD, 0.7, 1.0, 40.0)
        truth = true_corners(HD, view.T_c_v, LAYOUT)
        image = render(HD, view.T_c_v, LAYOUT, rng, Optics(), np.full((720, 1280), 105.0)).astype(
            np.float64
        )
        v, u = np.mgrid[0:720, 0:1280] - truth.mean(axis=0)[::-1, None, None]
        angle = rng.uniform(0.0, 2.0 * np.pi)
        across = u * np.cos(angle) + v * np.sin(angle) - rng.uniform(-4.0, 4.0)
        shaded = image * (1.0 - 0.5 * np.clip(across / 3.0 + 0.5, 0.0, 1.0))
        start = truth + rng.uniform(-0.4, 0.4, (4, 2))
        fitted = fit(shaded.astype(np.uint8), (0, 0), start, HD, CELLS)
        plain = fit(shaded.astype(np.uint8), (0, 0), start, HD, CELLS, ideal=True)
        assert fitted is not None and fitted.wrong[SHADOWED], seed
        error = float(np.sqrt(np.mean((fitted.corners_px - truth) ** 2)))
        assert error < 0.05
        if plain is not None:
            assert error < 0.5 * float(np.sqrt(np.mean((plain.corners_px - truth) ** 2)))


@pytest.mark.parametrize("picture_px", [26, 46])
def test_inner_edges_that_are_off_are_found_or_may_be_told(picture_px: int):
    """A picture of few pixels across was printed: of 46, cells of 8, 8, 7, 8, 8, 7 pixels."""
    ends = np.ceil(np.arange(7.0) * picture_px / 6.0 - 1e-9) * 6.0 / picture_px
    told = np.stack([ends, ends])
    found, plain, known, surprise = [], [], [], []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        image, truth = coarse_print(ends, rng)
        start = truth + rng.uniform(-0.4, 0.4, (4, 2))
        fits = [fit(image, (0, 0), start, STRAIGHT, CELLS, edges, ideal=ideal) for edges, ideal in (
            (None, False), (None, True), (told, True))]  # fmt: skip
        for errors, fitted in zip((found, plain, known), fits, strict=True):
            assert fitted is not None
            errors.append(fitted.corners_px - truth)
        assert fits[0] is not None and fits[0].wrong == (False, True, False)
        surprise.append(Sample(found[-1], 0.0, fits[0]).surprise)
    off = [float(np.sqrt(np.mean(np.square(errors)))) for errors in (found, plain, known)]
    assert off[0] < min(0.02, 0.2 * off[1])
    assert off[2] < 0.03
    assert np.mean(surprise) < 2.5


def test_edges_that_are_exact_are_not_taken_for_a_coarse_print():
    for seed in range(6):
        rng = np.random.default_rng(seed)
        image, truth = coarse_print(np.arange(7.0), rng)
        sharp = image + 1.0 * (image - cv2.GaussianBlur(image.astype(np.float64), (0, 0), 1.1))
        grey = np.clip(np.rint(sharp), 0.0, 255.0).astype(np.uint8)
        fitted = fit(grey, (0, 0), truth + rng.uniform(-0.4, 0.4, (4, 2)), STRAIGHT, CELLS)
        assert fitted is not None and not fitted.wrong[COARSE]


def test_inner_edges_that_are_off_far_do_not_pull_the_frame_of_a_large_marker_along():
    """Of 60 px: half a pixel of the picture that was printed is 1.2 px, as far as outliers are."""
    ends = np.ceil(np.arange(7.0) * 26.0 / 6.0 - 1e-9) * 6.0 / 26.0
    for seed in range(6):
        rng = np.random.default_rng(seed)
        image, truth = coarse_print(ends, rng, 60.0)
        fitted = fit(image, (0, 0), truth + rng.uniform(-1.0, 1.0, (4, 2)), STRAIGHT, CELLS)
        assert fitted is not None and fitted.wrong[COARSE]
        assert float(np.sqrt(np.mean((fitted.corners_px - truth) ** 2))) < 0.05


def coarse_print(
    ends: NDArray[np.float64], rng: np.random.Generator, side_px: float = 40.0
) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """A frontal marker of some 40 px, whose cells end at ``ends``, and its true corners."""
    side, zoom, size = side_px + rng.uniform(0.0, 3.0), 8, round(2.75 * side_px)
    corner = np.array([0.75, 0.75]) * side_px + rng.uniform(0.0, 1.0, 2)
    angle = rng.uniform(0.1, 0.7)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    grid = (np.arange(size * zoom) + 0.5) / zoom - 0.5
    u, v = np.meshgrid(grid, grid)
    x, y = (
        np.tensordot(turn.T, np.stack([u - corner[0] - 0.5 * side_px, v - corner[1]]), axes=1)
        * 6.0
        / side
    )
    places = [np.searchsorted(ends, axis, side="right") for axis in (x, y)]
    light = 40.0 + 150.0 * CELLS[places[1], places[0]]
    light = (
        cv2.GaussianBlur(light, (0, 0), 0.6 * zoom)
        .reshape(size, zoom, size, zoom)
        .mean(axis=(1, 3))
    )
    noisy = np.rint(light + rng.normal(0.0, 1.5, light.shape))
    square = np.array([[0.0, 0.0], [side, 0.0], [side, side], [0.0, side]])
    return np.clip(noisy, 0, 255).astype(np.uint8), square @ turn.T + corner + np.array(
        [0.5 * side_px, 0.0]
    )


@pytest.mark.parametrize("degrees", [26.57, 63.43])
def test_a_selection_of_the_pixels_of_a_large_marker_is_not_along_its_edges(degrees: float):
    turned = rotation.exp(np.array([0.0, 0.0, np.radians(degrees)])) @ np.diag([1.0, -1.0, -1.0])
    for k in range(2):
        T_c_v = Pose(turned, np.array([0.01 * k, 0.005, 0.3]))
        truth = HD.project(T_c_v.apply(LAYOUT.markers[0].corners_v))
        ground = np.full((720, 1280), 105.0)
        image = render(
            HD, T_c_v, LAYOUT, np.random.default_rng(k), Optics(noise=1.0, samples=12), ground
        )
        fitted = fit(image, (0, 0), truth + 0.2, HD, CELLS)
        assert fitted is not None
        assert float(np.sqrt(np.mean((fitted.corners_px - truth) ** 2))) < 0.02
