"""Fits of a film's frames, each of which begins with what the earlier ones told."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from path.camera.model import CameraModel
from path.geometry import rotation
from path.geometry.transforms import Pose
from path.marker.detect import detect_markers
from path.marker.layout import single_marker
from path.marker.photometric import corners
from path.marker.photometric.corners import PhotometricFit, fit
from path.marker.photometric.known import Known, Memory
from path.marker.photometric.misfit import FILTERED, SHADOWED
from tests.path.marker.scene import HD, VGA, Optics, random_view, render, true_corners
from tests.path.marker.test_photometric import CELLS, LAYOUT, STRAIGHT, coarse_print

Image = NDArray[Any]
COARSE_ENDS = np.ceil(np.arange(7.0) * 26.0 / 6.0 - 1e-9) * 6.0 / 26.0
MOST_PASSES = 4  # of a frame that begins with the answer


def near_fit(image: Image, truth: Image, known: Known, rng: np.random.Generator) -> PhotometricFit:
    start = truth + rng.uniform(-0.3, 0.3, (4, 2))
    grey = np.clip(np.rint(image), 0.0, 255.0).astype(np.uint8)
    camera = {480: VGA, 720: HD}.get(len(grey), STRAIGHT)
    fitted = fit(grey, (0, 0), start, camera, CELLS, near=True, known=known)
    assert fitted is not None
    return fitted


def off_px(fitted: PhotometricFit, truth: Image) -> float:
    return float(np.sqrt(np.mean((fitted.corners_px - truth) ** 2)))


def test_a_frame_of_a_film_begins_with_what_earlier_ones_told_of_the_print(
    monkeypatch: pytest.MonkeyPatch,
):
    known = Known.nothing(6)
    rng = np.random.default_rng(0)
    image, truth = coarse_print(COARSE_ENDS, rng)
    first = near_fit(image, truth, known, rng)

    def refuse(*_: object) -> None:
        raise AssertionError("asked everything again")

    monkeypatch.setattr(corners, "_fit_misfit", refuse)
    alone: list[float] = []
    film: list[float] = []
    for _ in range(10):
        image, truth = coarse_print(COARSE_ENDS, rng)
        later = near_fit(image, truth, known, rng)
        assert later.passes <= MOST_PASSES < first.passes
        film.append(off_px(later, truth))
        plain = fit(image, (0, 0), truth.copy(), STRAIGHT, CELLS, ideal=True)
        assert plain is not None
        alone.append(off_px(plain, truth))
    assert np.mean(film) < 0.03
    assert np.mean(film) < 0.3 * np.mean(alone)


def test_a_print_that_is_exact_stays_so():
    known = Known.nothing(6)
    rng = np.random.default_rng(1)
    for _ in range(12):
        image, truth = coarse_print(np.arange(7.0), rng)
        blurred = cv2.GaussianBlur(image.astype(np.float64), (0, 0), 1.1)
        fitted = near_fit(image + (image - blurred), truth, known, rng)
        assert off_px(fitted, truth) < 0.05
    assert float(np.abs(known.offsets).max()) < 0.02


def test_a_camera_whose_light_blooms_over_the_frame_is_not_taken_for_a_print_that_is_smaller():
    """Distances are made of its size. A coarse print's edges are off otherwise, too."""
    known = Known.nothing(6)
    grown = np.tile(0.006 * np.arange(-2.0, 3.0), 2)
    known.offsets = grown + 0.003
    assert known.believed == pytest.approx(np.full(10, 0.003), abs=0.002)
    known.offsets = grown + np.tile([0.1, -0.1, 0.0, -0.1, 0.1], 2)
    assert known.believed == pytest.approx(known.offsets, abs=0.002)


def test_another_print_is_learned_in_place_of_the_one_before():
    known = Known.nothing(6)
    rng = np.random.default_rng(2)
    for ends in (COARSE_ENDS, np.arange(7.0)):
        off: list[float] = []
        for _ in range(30):
            image, truth = coarse_print(ends, rng)
            off.append(off_px(near_fit(image, truth, known, rng), truth))
        assert np.median(off[10:]) < 0.035


def filmed(
    change: Callable[[Image, Image], Image], frames: int, camera: CameraModel = VGA
) -> list[tuple[Image, Image]]:
    """Frames of one view with what changes them, and the true corners."""
    view = random_view(np.random.default_rng(3), camera, 0.7, 1.0, 40.0)
    truth = true_corners(camera, view.T_c_v, LAYOUT)
    ground = np.full((camera.height, camera.width), 105.0)
    film: list[tuple[Image, Image]] = []
    for seed in range(frames):
        rng = np.random.default_rng(seed)
        image = render(camera, view.T_c_v, LAYOUT, rng, Optics(), ground).astype(np.float64)
        film.append((change(image, truth), truth))
    return film


def shaded(image: Image, truth: Image) -> Image:
    v, u = np.mgrid[0 : len(image), 0 : image.shape[1]] - truth.mean(axis=0)[::-1, None, None]
    return image * (1.0 - 0.5 * np.clip((0.8 * u + 0.6 * v - 2.0) / 3.0 + 0.5, 0.0, 1.0))


def moved(image: Image, _: Image) -> Image:
    return np.asarray(cv2.blur(image, (3, 1)), np.float64)


@pytest.mark.parametrize(
    ("change", "group", "camera"), [(shaded, SHADOWED, HD), (moved, FILTERED, VGA)]
)
def test_what_comes_in_the_middle_of_a_film_is_found_by_one_question_a_frame(
    change: Callable[[Image, Image], Image],
    group: int,
    camera: CameraModel,
    monkeypatch: pytest.MonkeyPatch,
):
    known = Known.nothing(6)
    rng = np.random.default_rng(4)
    for image, truth in filmed(lambda image, _: image, 2, camera):
        near_fit(image, truth, known, rng)
    asked: list[int] = []
    tried = corners._tried

    def counted(state: corners.FitState, which: int, **how: Any) -> object:
        asked.append(which)
        return tried(state, which, **how)

    monkeypatch.setattr(corners, "_tried", counted)
    found: list[bool] = []
    for image, truth in filmed(change, 6, camera):
        asked.clear()
        fitted = near_fit(image, truth, known, rng)
        assert len(asked) <= 1
        found.append(fitted.wrong[group])
        if found[-1]:
            assert off_px(fitted, truth) < 0.08
    assert all(found[2:])


def test_what_no_question_answers_is_not_asked_in_every_frame(monkeypatch: pytest.MonkeyPatch):
    """Sharpened frames: a filter leaves too much of them to be believed."""

    def sharp(image: Image, _: Image) -> Image:
        return np.clip(image + 1.5 * (image - cv2.GaussianBlur(image, (0, 0), 1.2)), 0.0, 255.0)

    known = Known.nothing(6)
    rng = np.random.default_rng(5)
    film = filmed(sharp, 8)
    near_fit(*film[0], known, rng)

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("asked")

    monkeypatch.setattr(corners, "_tried", refuse)
    for image, truth in film[1:]:
        fitted = near_fit(image, truth, known, rng)
        error = (fitted.corners_px - truth).ravel()
        assert float(error @ np.linalg.solve(fitted.covariance_px2, error)) / 8.0 < 2.5


def test_a_fit_that_fails_with_what_is_known_asks_everything_again():
    known = Known.nothing(6)
    rng = np.random.default_rng(6)
    image, truth = coarse_print(np.arange(7.0), rng)
    near_fit(image, truth, known, rng)
    assert known.frames == 1
    nothing = np.random.default_rng(7).integers(0, 255, image.shape, dtype=np.uint8)
    if fit(nothing, (0, 0), truth.copy(), STRAIGHT, CELLS, near=True, known=known) is None:
        assert known.frames == 0
    memory: Memory = {0: known}
    pose = Pose(rotation.exp(np.array([np.pi - 0.4, 0.0, 0.3])), np.array([0.0, 0.0, 0.8]))
    shot = render(HD, pose, LAYOUT, rng, Optics(), np.full((720, 1280), 105.0))
    assert detect_markers(shot, None, LAYOUT, HD, memory=memory)
    assert memory[0] is not known, "a search begins anew"
    begun = memory[0]
    assert detect_markers(shot, None, LAYOUT, HD, expected=pose, memory=memory)
    assert memory[0] is begun and begun.frames == 2


def test_each_marker_of_a_layout_has_its_own_memory():
    memory: Memory = {}
    layout = single_marker(marker_id=7)
    pose = Pose(rotation.exp(np.array([np.pi - 0.4, 0.0, 0.3])), np.array([0.0, 0.0, 0.8]))
    shot = render(HD, pose, layout, np.random.default_rng(8), Optics(), np.full((720, 1280), 105.0))
    detect_markers(shot, None, layout, HD, memory=memory)
    assert list(memory) == [7]


@pytest.mark.parametrize("ends", [np.arange(7.0), COARSE_ENDS], ids=["alike", "of another kind"])
def test_a_marker_that_is_new_to_a_camera_begins_with_what_others_told_of_it(
    ends: Image, monkeypatch: pytest.MonkeyPatch
):
    rng = np.random.default_rng(9)
    memory: Memory = {3: Known.nothing(6)}
    for _ in range(3):
        image, truth = coarse_print(np.arange(7.0), rng)
        near_fit(image, truth, memory[3], rng)
    known = Known.among(memory.values(), 6)
    assert (known.frames, known.blur_px, known.own) == (1, memory[3].blur_px, False)
    assert not known.offsets.any(), "another print's edges are elsewhere"
    asked: list[bool] = []
    everything = corners._fit_misfit

    def counted(state: corners.FitState) -> corners.FitState:
        asked.append(True)
        return everything(state)

    monkeypatch.setattr(corners, "_fit_misfit", counted)
    for _ in range(4):
        image, truth = coarse_print(ends, rng)
        later = near_fit(image, truth, known, rng)
        assert off_px(later, truth) < 0.05
        assert known.own
    assert len(asked) == (0 if ends is not COARSE_ENDS else 1)
    assert Known.among([], 6).frames == Known.among(memory.values(), 5).frames == 0
