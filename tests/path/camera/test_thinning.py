"""Where the pixels are that a camera keeps, and what it projects."""

from __future__ import annotations

import numpy as np
import pytest

from path.camera.kernels import lens_of, place
from path.camera.model import CameraModel
from path.camera.thinning import Array, Thinning
from path.compiled import kernel

THINNED = Thinning(3, 5, (1, 2))


@kernel
def _places(lens: Array, axis: int, count: int) -> Array:
    found = np.empty(count)
    for pixel in range(count):
        found[pixel] = place(lens, axis, pixel)
    return found


def test_pixels_that_are_kept_are_those_nearest_to_their_places() -> None:
    assert Thinning(3, 5, (0, 0)).offsets_px(0) == pytest.approx([-0.2, 0.0, 0.2])
    assert Thinning(1, 2, (0, 0)).offsets_px(1) == pytest.approx([0.25])
    for thinning in (THINNED, Thinning(2, 3, (0, 1)), Thinning(4, 5, (3, 0))):
        for axis in (0, 1):
            sensor, places = thinning.sensor_pixels(24, axis), thinning.places(np.arange(24), axis)
            assert sensor[0] == 0
            assert sensor[-1] == pytest.approx(23 * thinning.of / thinning.kept, abs=1.0)
            assert places - np.arange(24) == pytest.approx(np.resize(thinning.offsets_px(axis), 24))
            assert [thinning.sensor_place(at, axis) for at in places] == pytest.approx(sensor)


def test_what_flies_knows_the_same_places() -> None:
    for thinning in (THINNED, Thinning(2, 3, (0, 1)), Thinning(4, 5, (3, 0))):
        lens = lens_of(CameraModel(60, 40, 50.0, 50.0, 30.0, 20.0, thinning=thinning))
        for axis in (0, 1):
            assert _places(lens, axis, 40).tolist() == thinning.places(np.arange(40), axis).tolist()
    even = CameraModel(60, 40, 50.0, 50.0, 30.0, 20.0)
    assert _places(lens_of(even), 0, 40).tolist() == list(range(40))


def test_places_between_pixels_are_shared_out() -> None:
    camera = CameraModel(60, 40, 50.0, 50.0, 30.0, 20.0, thinning=THINNED)
    pixels = np.array([[7.0, 11.0], [8.0, 12.0]])
    even = np.column_stack([THINNED.places(pixels[:, axis], axis) for axis in (0, 1)])
    assert camera.even(pixels) == pytest.approx(even)
    assert camera.even(pixels.mean(axis=0, keepdims=True))[0] == pytest.approx(even.mean(axis=0))


@pytest.mark.parametrize(
    ("kept", "of", "begins"), [(3, 3, (0, 0)), (0, 2, (0, 0)), (2, 3, (2, 0)), (2, 3, (0, -1))]
)
def test_what_leaves_nothing_out_is_refused(kept: int, of: int, begins: tuple[int, int]) -> None:
    with pytest.raises(ValueError, match=r"kept|begins"):
        Thinning(kept, of, begins)
