"""The sensor behind a mosaic: in whole numbers what the pipeline of trials does in real ones."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from flight.harness.measured import MEASURED
from flight.harness.renderer import REALISTIC, Imaging
from hil.camera.pipeline import develop
from hil.render.mosaic import MosaicSensor, as_yuyv, is_quick
from hil.render.sensor import noise_pool
from path.calibration.edges import PLACES, SeenEdge, mean_edge, see_edge

QUIET = replace(MEASURED, read_sigma=0.0)
HEIGHT, WIDTH = 120, 160
KEY = 0x5A_17_42_99
SEEN_AT_PX = (-1.84, -1.09, -0.71, -0.34, 0.04, 0.41, 0.79, 1.16, 1.54)
PHOTOGRAPHED = (-0.015, 0.0, 0.095, 0.248, 0.452, 0.675, 0.868, 0.981, 1.037)
"""Shares of white at distances from an edge, as the photographs of the measured camera have
them.
"""


def image(imaging: Imaging, light: NDArray[np.uint8], key: int = KEY) -> NDArray[np.float64]:
    _, height, width = light.shape
    pool = noise_pool(np.random.default_rng(1), height, width, 0.0)
    return MosaicSensor(imaging, height, width, pool).image(light, key).astype(float)


def colored() -> NDArray[np.uint8]:
    """Something with colours and edges of every direction."""
    planes = np.random.default_rng(2).integers(
        0, 256, (3, HEIGHT // 12, WIDTH // 12), dtype=np.uint8
    )
    return np.stack(
        [cv2.resize(each, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC) for each in planes]
    )


def flat(level: int) -> NDArray[np.uint8]:
    return np.full((3, HEIGHT, WIDTH), level, np.uint8)


def test_it_is_what_the_pipeline_of_trials_does() -> None:
    light = colored()
    off = image(QUIET, light) - develop(light, QUIET, np.random.default_rng(0))
    assert np.abs(off.mean(axis=(0, 1))).max() < 0.4
    assert off.std() < 1.5  # 8 bits before the sharpening, which enlarges them


@pytest.mark.parametrize("level", [40, 162])
def test_noise_is_that_of_the_photographs(level: int) -> None:
    grey = image(MEASURED, flat(level)).mean(axis=2)
    assert grey.std() == pytest.approx({40: 2.05, 162: 1.74}[level], rel=0.25)
    assert grey.mean() == pytest.approx(level, abs=1.0)


def test_noise_is_another_with_another_key_and_the_same_with_the_same() -> None:
    one, same, other = (image(MEASURED, flat(100), key) for key in (KEY, KEY, KEY + (1 << 16)))
    assert np.array_equal(one, same)
    assert not np.array_equal(one, other)


def slanted_edge(slant_rad: float) -> SeenEdge:
    u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    across = math.cos(slant_rad) * (u - WIDTH / 2) + math.sin(slant_rad) * (v - HEIGHT / 2)
    light = np.round(40.0 + 122.0 * np.clip(across + 0.5, 0.0, 1.0)).astype(np.uint8)
    grey = cv2.cvtColor(image(QUIET, np.stack([light] * 3)).astype(np.uint8), cv2.COLOR_BGR2GRAY)
    along = np.array([-math.sin(slant_rad), math.cos(slant_rad)])
    edge = see_edge(
        np.asarray(grey, np.uint8),
        np.array([WIDTH / 2, HEIGHT / 2]) + np.outer((-50.0, 50.0), along),
    )
    assert edge is not None
    return edge


def test_an_edge_is_drawn_as_on_the_photographs() -> None:
    edges = [slanted_edge(slant_rad) for slant_rad in np.linspace(0.05, 0.6, 12)]
    drawn = np.interp(SEEN_AT_PX, PLACES, mean_edge(edges))
    assert drawn == pytest.approx(np.array(PHOTOGRAPHED), abs=0.04)


def test_colour_has_half_the_width() -> None:
    shown = as_yuyv(np.moveaxis(colored(), 0, -1).copy(), 0.0, 1.0)
    again = as_yuyv(shown, 0.0, 1.0)
    # what has half the width already keeps it
    assert np.abs(shown.astype(int) - again).mean() < 0.6
    odd = np.zeros((4, 5, 3), np.uint8)
    with pytest.raises(ValueError, match="odd in width"):
        as_yuyv(odd, 0.0, 1.0)


def test_an_imaging_that_asks_for_more_is_refused() -> None:
    assert is_quick(MEASURED)
    for other in (
        REALISTIC,
        Imaging(),
        replace(MEASURED, gamma=2.2),
        replace(MEASURED, motion_px=(1.0, 0.0)),
    ):
        assert not is_quick(other)
        with pytest.raises(ValueError, match="imaging"):
            MosaicSensor(
                other, HEIGHT, WIDTH, noise_pool(np.random.default_rng(0), HEIGHT, WIDTH, 0.0)
            )
