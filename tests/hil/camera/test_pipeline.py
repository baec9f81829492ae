"""Every effect of the camera does what it says, by as much as it says."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from flight.harness.renderer import (
    IDEAL,
    PRINTED,
    REALISTIC,
    REALISTIC_VIDEO,
    Imaging,
    Printing,
    RenderedInstant,
    RendererSetup,
)
from hil.camera.pictures import CameraRenderer
from hil.camera.pipeline import blur_kernel, develop, h264, is_plain, jpeg
from path.marker.layout import single_marker
from path.messages import Role
from tests.hil.render.views import TAIL, VGA, hovering, mount

Array = NDArray[np.float64]

QUIET = Imaging(blur_sigma_px=0.0, read_sigma=0.0, shot_gain=0.0)
DARK, BRIGHT = 60.0, 180.0
T_W_B = {Role.SENDER: hovering(0.0, 0.0, 1.4), Role.RECEIVER: hovering(0.1, -0.8, 1.9, -0.1)}


def flat(level: float | tuple[float, float, float], size: int = 64) -> NDArray[np.uint8]:
    return np.broadcast_to(np.array(level, np.uint8).reshape(-1, 1, 1), (3, size, size)).copy()


def step_edge(size: int = 64) -> NDArray[np.uint8]:
    """Dark on the left, bright from the middle column on."""
    light = flat(DARK, size)
    light[:, :, size // 2 :] = BRIGHT
    return light


def seen(light: NDArray[np.uint8], imaging: Imaging, seed: int = 0) -> Array:
    return develop(light, imaging, np.random.default_rng(seed)).astype(float)


def spread_of(profile: Array) -> float:
    """Variance in px^2 of the derivative of an edge's profile."""
    slope = np.diff(profile)
    at = np.arange(len(slope)) + 0.5
    mean = (slope @ at) / slope.sum()
    return float(slope @ (at - mean) ** 2 / slope.sum())


def test_the_default_is_plain_and_nothing_else_is() -> None:
    assert is_plain(IDEAL)
    assert is_plain(Imaging(0.9, 3.0, 0.1))
    changed = (
        Imaging(exposure=1.1),
        Imaging(motion_px=(0.0, 1.0)),
        Imaging(mosaic=True),
        Imaging(gamma=2.2),
        Imaging(sharpen=0.5),
        Imaging(jpeg_quality=90),
        Imaging(h264_crf=23),
        REALISTIC,
        REALISTIC_VIDEO,
    )
    assert not any(is_plain(imaging) for imaging in changed)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("read_sigma", -1.0),
        ("exposure", 0.0),
        ("gamma", math.nan),
        ("motion_px", (math.inf, 0.0)),
        ("motion_px", (80.0, 80.0)),
        ("jpeg_quality", 0),
        ("h264_crf", 52),
    ],
)
def test_what_cannot_be_is_refused_by_name(field: str, value: object) -> None:
    with pytest.raises(ValueError, match=field):
        Imaging(**{field: value})  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="ink_spread_m"):
        Printing(ink_spread_m=-1e-4)


def test_without_effects_the_image_is_the_light() -> None:
    light = np.random.default_rng(0).integers(0, 256, (3, 20, 30), np.uint8)
    assert np.array_equal(seen(light, QUIET), np.moveaxis(light, 0, -1))


def test_optics_and_noise_are_those_of_the_plain_camera() -> None:
    """The pipeline, forced by a gamma that changes nothing visible, against the renderer's own
    exposure.
    """
    stage = RenderedInstant({Role.RECEIVER: T_W_B[Role.RECEIVER]})
    almost = replace(IDEAL, gamma=1.0 + 1e-9)
    assert not is_plain(almost)
    images = [
        np.stack(
            [
                CameraRenderer(RendererSetup(VGA, mount(45.0), TAIL, single_marker(), imaging), 1)
                .shoot(stage, Role.RECEIVER, k)
                .color[::3, ::3]
                for k in range(3)
            ]
        ).astype(float)
        for imaging in (IDEAL, almost)
    ]
    means = [stack.mean(axis=0) for stack in images]
    assert np.mean(means[0] - means[1]) == pytest.approx(0.0, abs=0.03)
    # sigma of a single image: 1.6 to 2.2
    assert np.std(means[0] - means[1]) < 2.2 * np.sqrt(2.0 / 3.0)
    assert np.std(images[0] - means[0]) == pytest.approx(np.std(images[1] - means[1]), rel=0.03)


def test_exposure_multiplies_the_light_until_it_saturates() -> None:
    assert seen(flat(100.0), replace(QUIET, exposure=1.5)).mean() == 150.0
    assert seen(flat(200.0), replace(QUIET, exposure=1.5)).min() == 255.0


@pytest.mark.parametrize("length", [1.0, 2.0, 3.0])
def test_motion_widens_edges_along_it_by_its_own_variance(length: float) -> None:
    blurred = replace(QUIET, blur_sigma_px=0.7)
    along = seen(step_edge(), replace(blurred, motion_px=(length, 0.0)))[32, :, 1]
    across = seen(step_edge(), replace(blurred, motion_px=(0.0, length)))[32, :, 1]
    still = seen(step_edge(), blurred)[32, :, 1]
    assert np.abs(across - still).max() <= 1.0
    assert spread_of(along) - spread_of(still) == pytest.approx(length**2 / 12.0, abs=0.06)


def test_motion_moves_nothing() -> None:
    kernel = blur_kernel(0.6, (2.4, -1.3))
    at = np.arange(len(kernel)) - len(kernel) // 2
    assert kernel.sum() == pytest.approx(1.0)
    assert kernel.sum(axis=0) @ at == pytest.approx(0.0, abs=1e-12)
    covariance = float(at @ kernel @ at)  # rows are v, columns u
    assert covariance == pytest.approx(-2.4 * 1.3 / 12.0, abs=0.01)


def test_gamma_is_the_power_of_the_light() -> None:
    for level in (10.0, 26.0, 128.0, 228.0):
        expected = 255.0 * (level / 255.0) ** (1.0 / 2.2)
        assert seen(flat(level), replace(QUIET, gamma=2.2)).mean() == pytest.approx(
            expected, abs=0.51
        )


def test_noise_comes_before_gamma() -> None:
    """So that it is larger in the dark of the image, where the curve is steep."""
    noisy = replace(QUIET, read_sigma=2.0, gamma=2.2)
    for level in (30.0, 200.0):
        slope = (level / 255.0) ** (1.0 / 2.2 - 1.0) / 2.2
        assert seen(flat(level, 128), noisy).std() == pytest.approx(2.0 * slope, rel=0.06)


@pytest.mark.parametrize("amount", [0.5, 1.0])
def test_sharpening_overshoots_at_edges_by_what_the_blurs_differ(amount: float) -> None:
    imaging = replace(QUIET, blur_sigma_px=0.7, sharpen=amount, sharpen_sigma_px=1.1)
    profile = seen(step_edge(), imaging)[32, :, 1]

    def blurred(values: Array, sigma: float) -> Array:
        at = np.arange(-12, 13)
        kernel = np.exp(-0.5 * (at / sigma) ** 2)
        return np.asarray(
            np.convolve(np.pad(values, 12, mode="edge"), kernel / kernel.sum(), mode="valid"), float
        )

    sharp = blurred(step_edge()[1, 32].astype(float), 0.7)
    expected = sharp + amount * (sharp - blurred(sharp, 1.1))
    assert profile.max() > BRIGHT + 9.0 * amount
    assert profile.min() < DARK - 9.0 * amount
    assert np.abs(profile - expected).max() < 1.0


def test_the_halo_of_the_realistic_camera_is_that_of_a_webcam() -> None:
    """On a photograph of a printed board it is 15 % of the contrast on black and 6 % on white."""
    quiet = replace(REALISTIC, read_sigma=0.0, shot_gain=0.0, jpeg_quality=None)
    profile = seen(step_edge(), quiet)[32, :, 1]
    contrast = profile[53] - profile[10]
    assert (profile[10] - profile.min()) / contrast == pytest.approx(0.15, abs=0.04)
    assert (profile.max() - profile[53]) / contrast == pytest.approx(0.06, abs=0.04)


def test_a_mosaic_keeps_colours_and_frays_their_edges() -> None:
    mosaic = replace(QUIET, mosaic=True)
    color = (40.0, 110.0, 210.0)
    assert np.array_equal(seen(flat(color), mosaic), np.broadcast_to(color, (64, 64, 3)))
    edge = seen(step_edge(), mosaic)
    assert np.ptp(edge, axis=2).max() > 20.0  # grey gets coloured fringes
    assert np.ptp(edge[:, :28], axis=2).max() == 0.0


def test_a_mosaic_correlates_the_noise() -> None:
    def neighbours(mosaic: bool) -> float:
        noise = (
            seen(flat(120.0, 128), replace(QUIET, read_sigma=4.0, mosaic=mosaic))[..., 2] - 120.0
        )
        return float(np.corrcoef(noise[:, 1:].ravel(), noise[:, :-1].ravel())[0, 1])

    assert abs(neighbours(False)) < 0.03
    assert neighbours(True) > 0.3


def test_jpeg_loses_more_the_harder_it_compresses() -> None:
    light = np.random.default_rng(1).integers(60, 200, (3, 64, 64), np.uint8)
    light = np.stack([cv2.GaussianBlur(plane, (0, 0), 2.0) for plane in light])
    plain = seen(light, QUIET)
    losses = [
        np.abs(seen(light, replace(QUIET, jpeg_quality=q)) - plain).mean() for q in (98, 90, 50)
    ]
    assert 0.0 < losses[0] < losses[1] < losses[2] < 8.0


def scenery(shift: int = 0) -> NDArray[np.uint8]:
    """Blurred noise, (96, 128, 3), that moves ``shift`` px to the right."""
    wide = cv2.GaussianBlur(np.random.default_rng(2).uniform(0, 255, (96, 160)), (0, 0), 3.0)
    wide = 110.0 + 4.0 * (wide - wide.mean())
    return np.repeat(
        np.clip(wide[:, 16 - shift : 144 - shift, None], 0, 255).astype(np.uint8), 3, axis=2
    )


def test_h264_gives_each_frame_of_a_stream_in_its_place() -> None:
    frames = [scenery(shift) for shift in (6, 3, 0)]
    decoded = h264(frames, 20)
    assert len(decoded) == 3
    for frame, after in zip(frames, decoded, strict=True):
        slopes = np.stack([slope.ravel() for slope in np.gradient(frame[..., 1].astype(float))])
        shift = np.linalg.lstsq(slopes.T, (after[..., 1].astype(float) - frame[..., 1]).ravel())[0]
        assert np.abs(shift).max() < 0.03
        assert 0.0 < np.abs(frame.astype(int) - after).mean() < 4.0
    losses = [np.abs(h264(frames, crf)[-1].astype(int) - frames[-1]).mean() for crf in (10, 23, 36)]
    assert losses[0] < losses[1] < losses[2]


def test_what_comes_out_of_a_stream_is_its_last_frame_in_its_place() -> None:
    light = np.ascontiguousarray(np.moveaxis(scenery(), -1, 0))
    plain = seen(light, QUIET)[..., 1]
    slopes = np.stack([slope.ravel() for slope in np.gradient(plain)])
    for seed in range(4):  # the view moves differently in each
        streamed = seen(light, replace(QUIET, h264_crf=16), seed)[..., 1]
        shift = np.linalg.lstsq(slopes.T, (streamed - plain).ravel())[0]
        assert np.abs(shift).max() < 0.05


def test_h264_gives_the_same_bytes_again_and_refuses_odd_sides() -> None:
    light = np.ascontiguousarray(np.moveaxis(scenery(), -1, 0))
    first, again = (seen(light, REALISTIC_VIDEO, 3) for _ in range(2))
    assert np.array_equal(first, again)
    assert np.any(first != seen(light, REALISTIC_VIDEO, 4))
    with pytest.raises(ValueError, match="odd"):
        seen(light[:, :, 1:], REALISTIC_VIDEO)


def test_jpeg_and_h264_leave_grey_grey() -> None:
    for image in (jpeg(scenery(), 90), h264([scenery()], 23)[0]):
        assert np.ptp(image.astype(int), axis=2).max() <= 3


@pytest.mark.parametrize("imaging", [REALISTIC, REALISTIC_VIDEO])
def test_a_shot_of_the_realistic_camera_repeats_byte_for_byte(imaging: Imaging) -> None:
    setup = RendererSetup(VGA, mount(45.0), TAIL, single_marker(), imaging, PRINTED)
    first, again = (
        CameraRenderer(setup, 1).shoot(RenderedInstant(T_W_B), Role.RECEIVER, 5) for _ in range(2)
    )
    assert first.color.tobytes() == again.color.tobytes()
    other = CameraRenderer(setup, 1).shoot(RenderedInstant(T_W_B), Role.RECEIVER, 6)
    assert np.any(first.color != other.color)
