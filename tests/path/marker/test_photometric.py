"""The photometric fit against exact images: bias, noise, claimed covariance, model mismatch."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from path.camera import CameraModel
from path.marker.layout import single_marker
from path.marker.pattern import UNKNOWNS, _evaluate
from path.marker.photometric import PhotometricFit, fit
from path.marker.texture import cells
from tests.path.marker.scene import HD, VGA, Optics, random_view, region_around, render, true_corners

LAYOUT = single_marker()
CELLS = np.pad(cells("DICT_4X4_50", 0), 1, constant_values=1.0)


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


def sample(camera: CameraModel, seed: int, optics: Optics, start_px: float = 0.4, far_m: float = 1.5) -> Sample:
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
    assert all(s.fitted.blur_px == pytest.approx(np.hypot(0.7, np.sqrt(1 / 12)), abs=0.06) for s in found)


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
def test_light_that_is_not_ideal_is_part_of_the_model_or_of_the_covariance(optics: Optics, limit_px: float):
    found = [sample(VGA, seed, optics) for seed in range(20)]
    assert rms(found) < limit_px
    assert np.mean([s.surprise for s in found]) < 2.5


def test_what_the_model_does_not_know_makes_it_less_sure():
    plain = [sample(VGA, seed, Optics(noise=1.0)) for seed in range(10)]
    sharp = [sharpened(seed) for seed in range(10)]
    assert np.mean([s.surprise for s in sharp]) < 2.5
    assert np.sqrt(np.trace(sharp[0].fitted.covariance_px2)) > 2.0 * np.sqrt(np.trace(plain[0].fitted.covariance_px2))


def sharpened(seed: int) -> Sample:
    rng = np.random.default_rng(seed)
    view = random_view(rng, VGA, 0.7, 1.5, 50.0)
    truth = true_corners(VGA, view.T_c_v, LAYOUT)
    image = render(VGA, view.T_c_v, LAYOUT, rng, Optics(noise=1.0), np.full((480, 640), 105.0)).astype(np.float64)
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
    assert fit(image, (0, 0), np.array([[300.0, 300], [330, 300], [330, 330], [300, 330]]), VGA, CELLS) is None


def test_derivatives_are_those_of_the_grey_value():
    rng = np.random.default_rng(7)
    theta = np.array([2.1, 0.3, 3.1, -0.2, 2.3, 2.8, 0.0, 0.0, 40.0, 3.0, -2.0, 150.0, 5.0, -4.0, 0.02, 0.2])
    frame = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 11.0, 1.0, -2.0, 12.0])
    work, ignored = np.empty((6, 9)), np.empty(UNKNOWNS)
    pixels = np.column_stack([rng.uniform(-1.3, 1.3, (60, 2)), np.zeros(60)])
    rows = np.empty((60, UNKNOWNS))
    for pixel, row in zip(pixels, rows, strict=True):
        _evaluate(pixel, theta, frame, CELLS, work, row)
    for k in (2, 5, *range(8, UNKNOWNS)):  # the rest of the homography turns the blur too; a shift leaves it as it is
        h = np.zeros(UNKNOWNS)
        h[k] = 1e-6 * max(1.0, abs(theta[k]))
        slope = [
            (
                _evaluate(p, theta + h, frame, CELLS, work, ignored)
                - _evaluate(p, theta - h, frame, CELLS, work, ignored)
            )
            / (2.0 * h[k])
            for p in pixels
        ]
        assert np.linalg.norm(rows[:, k] - slope) < 0.1 * np.linalg.norm(slope), k
