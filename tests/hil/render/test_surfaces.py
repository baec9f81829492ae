"""In scenes that are not ideal, depth is lost on black surfaces, and on paint in which the sun is
mirrored.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from hil.render.looks import LOOKS
from hil.render.renderer import Renderer
from hil.render.scene import car, standing
from hil.render.sensor import NOISE_FREE
from hil.world.config import SceneName
from path.camera.model import CameraModel
from path.geometry.transforms import Pose
from path.marker.layout import single_marker
from tests.hil.render.views import LEVEL, TAIL

Depth = NDArray[np.uint16]

CAMERA = CameraModel(320, 240, 300.0, 300.0, 160.0, 120.0)


def looking(azimuth_deg: float, elevation_deg: float, away_m: float = 0.8) -> Pose:
    """The pose of a camera that looks at a car at the origin from there. ``azimuth_deg``: clockwise
    from north.
    """
    a, e = np.radians([azimuth_deg, elevation_deg])
    outwards = np.array([np.cos(e) * np.sin(a), np.cos(e) * np.cos(a), np.sin(e)])
    forward = -outwards
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return Pose(
        np.column_stack([right, np.cross(forward, right), forward]),
        away_m * outwards + [0.0, 0.0, 0.08],
    )


def measured(name: SceneName, T_w_c: Pose, key: int = 3) -> tuple[Depth, NDArray[np.uint8]]:
    """A car's depth in a scene, and its picture in one without shadows."""
    body = standing(car(), (0.0, 0.0, 0.0), 0.6)
    noisy, plain = (
        Renderer(CAMERA, LEVEL, TAIL, single_marker(), NOISE_FREE, 5, each)
        for each in (name, "plain")
    )
    _, depth = noisy.draw(T_w_c, [body], key)
    light, _ = plain.draw(T_w_c, [body], key)
    return depth, np.moveaxis(light, 0, -1)


def lost(depth: Depth, where: NDArray[np.bool_]) -> float:
    """Share of such pixels, away from edges, that have no depth."""
    inner = cv2.erode(where.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    assert inner.sum() > 30
    return float(np.mean(depth[inner] == 0))


def black(light: NDArray[np.uint8]) -> NDArray[np.bool_]:
    return light.max(axis=-1) < 45


def orange(light: NDArray[np.uint8]) -> NDArray[np.bool_]:
    return (light[..., 2] > 110) & (light[..., 0] < 40)


@pytest.mark.parametrize("name", ["overcast", "dusk", "hall"])
def test_black_tyres_lose_depth_and_paint_keeps_it(name: SceneName) -> None:
    depth, light = measured(name, looking(20.0, 30.0, 0.5))
    assert lost(depth, black(light)) == pytest.approx(LOOKS[name].dark_lost, abs=0.15)
    assert lost(depth, orange(light)) == 0.0


def test_on_plain_nothing_is_lost() -> None:
    depth, light = measured("plain", looking(20.0, 30.0, 0.5))
    assert lost(depth, black(light)) == lost(depth, orange(light)) == 0.0


@pytest.mark.parametrize("name", ["outdoor-sun", "low-sun"])
def test_paint_that_mirrors_the_sun_into_the_camera_loses_depth(name: SceneName) -> None:
    """The roof does, seen from as high as the sun is and from opposite to it."""
    x, y, z = LOOKS[name].sun_w
    azimuth, elevation = (
        math.degrees(math.atan2(x, y)),
        math.degrees(math.atan2(z, math.hypot(x, y))),
    )
    (mirrored, light), (seen, other) = (
        measured(name, looking(azimuth + turned, elevation)) for turned in (180.0, 90.0)
    )
    assert lost(mirrored, orange(light)) > 0.1  # low sun: little of the roof is in view
    assert lost(seen, orange(other)) == 0.0


def test_the_same_arguments_lose_the_same_pixels() -> None:
    view = looking(20.0, 30.0, 0.5)
    assert np.array_equal(measured("overcast", view)[0], measured("overcast", view)[0])
    assert not np.array_equal(
        measured("overcast", view)[0] == 0, measured("overcast", view, key=400)[0] == 0
    )
