"""Range by apparent size."""

from __future__ import annotations

import pytest

from path.camera.model import CameraModel
from path.observations import Box
from path.target.monocular import TargetSize, extent_at, monocular_range

CAMERA = CameraModel(960, 720, 920.0, 918.0, 480.0, 360.0)
SIZE = TargetSize(0.30, 0.10)


def box_at(z_m: float, size_m: float = 0.30, wide: float = 1.0) -> Box:
    w, h = wide * CAMERA.fx * size_m / z_m, CAMERA.fy * size_m / z_m / wide
    return Box(400.0 - w / 2, 300.0 - h / 2, w, h)


@pytest.mark.parametrize("z_m", [0.8, 2.0, 4.0])
@pytest.mark.parametrize("wide", [0.8, 1.0, 1.4])
def test_a_box_of_that_size_is_that_far_away_whatever_its_shape(z_m: float, wide: float) -> None:
    depth = monocular_range(box_at(z_m, wide=wide), CAMERA, SIZE)
    assert depth is not None
    assert depth.z_m == pytest.approx(z_m)
    assert 0.10 * z_m < depth.sigma_m < 0.12 * z_m


def test_an_error_of_size_is_within_what_it_says() -> None:
    depth = monocular_range(box_at(2.0, size_m=0.33), CAMERA, SIZE)
    assert depth is not None
    assert abs(depth.z_m - 2.0) < depth.sigma_m


def test_few_pixels_know_less() -> None:
    near, far = (
        monocular_range(box_at(1.0), CAMERA, SIZE),
        monocular_range(box_at(25.0), CAMERA, SIZE),
    )
    assert near is not None
    assert far is not None
    assert far.sigma_m / far.z_m > 1.5 * near.sigma_m / near.z_m


@pytest.mark.parametrize(
    "box",
    [
        Box(-3.0, 100.0, 90.0, 60.0),
        Box(100.0, 0.0, 90.0, 60.0),
        Box(900.0, 100.0, 90.0, 60.0),
        Box(100.0, 680.0, 90.0, 60.0),
        Box(100.0, 100.0, 2.0, 60.0),
        Box(100.0, 100.0, float("nan"), 60.0),
    ],
)
def test_a_box_that_is_cut_or_none_has_no_range(box: Box) -> None:
    assert monocular_range(box, CAMERA, SIZE) is None


@pytest.mark.parametrize("name", ["apparent_m", "sigma", "pixel_sigma_px"])
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan")])
def test_sizes_that_cannot_be(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        TargetSize(**{"apparent_m": 0.3, name: value})


def test_the_size_of_a_box_at_a_depth_is_told_in_pixels() -> None:
    extent = extent_at(2.0, 600.0, TargetSize(0.4, 0.1, longest_m=0.6))
    assert (extent.usual_px, extent.most_px, extent.longest_px) == pytest.approx(
        (120.0, 144.0, 180.0)
    )
