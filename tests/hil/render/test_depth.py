"""The depth camera beside the colour camera: registered, its depth is that of the colour camera's
own pixels.
"""

from __future__ import annotations

import numpy as np
import pytest

from drivers.realsense.registration import DepthRegistration
from hil.camera.d415 import T_COLOR_DEPTH, depth_camera
from hil.render.depth import DepthRenderer
from hil.render.renderer import Renderer
from hil.render.sensor import NOISE_FREE, SensorNoise
from hil.world.snapshot import DroneTruth, ObjectTruth, Snapshot
from path.camera.model import CameraModel
from path.geometry.transforms import Pose
from path.marker.layout import single_marker
from path.messages import Role

CAMERA = CameraModel(320, 240, 307.6, 307.9, 161.0, 120.6, (0.112, -0.236, 0.0006, -0.0004, 0.095))
DEPTH = depth_camera(320, 240)
LEVEL = Pose(np.eye(3), np.zeros(3))
ABOVE = Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.1, -0.2, 1.6]))  # looks down
ASIDE = Pose(np.eye(3), np.array([5.0, 5.0, 1.0]))


def snapshot(*, depth_holes: bool = False) -> Snapshot:
    drones = {
        Role.SENDER: DroneTruth(ABOVE, (0.0, 0.0, 0.0), 0.0, True),
        Role.RECEIVER: DroneTruth(ASIDE, (0.0, 0.0, 0.0), 0.0, True),
    }
    return Snapshot(
        0.0, drones, (ObjectTruth(0, (0.1, -0.1, 0.0), 0.4, 0.0),), depth_holes=depth_holes
    )


def renderers(noise: SensorNoise) -> tuple[Renderer, DepthRenderer]:
    color = Renderer(CAMERA, LEVEL, LEVEL, single_marker(), noise, seed=3)
    return color, DepthRenderer(color, DEPTH, T_COLOR_DEPTH)


def test_registered_it_is_the_depth_of_the_colour_camera_s_pixels() -> None:
    color, depth = renderers(NOISE_FREE)
    _, truth = color.render(snapshot(), Role.SENDER, 0)
    raw = depth.render(snapshot(), Role.SENDER, 0)
    assert len(np.unique(truth)) > 20  # a car stands there
    # and the cameras see it in other pixels
    assert np.abs(raw.astype(int) - truth)[60:180, 80:240].max() > 100
    out = DepthRegistration(DEPTH, CAMERA, T_COLOR_DEPTH, 0.001, (0.3, 6.0)).register(raw)
    both = (out > 0) & (truth > 0)
    assert both[10:-10, 10:-10].mean() > 0.97
    error = np.abs(out.astype(int) - truth)[both]
    assert np.median(error) <= 2
    assert (error > 10).mean() < 0.03  # outlines


def test_colour_alone_is_the_same_colour() -> None:
    color, _ = renderers(SensorNoise())
    both, _ = color.render(snapshot(), Role.SENDER, 5)
    np.testing.assert_array_equal(color.render_color(snapshot(), Role.SENDER, 5), both)


def test_its_noise_is_that_of_the_model_and_its_own() -> None:
    noisy, exact = renderers(SensorNoise())[1], renderers(NOISE_FREE)[1]
    images = [noisy.render(snapshot(), Role.SENDER, number).astype(int) for number in (1, 2)]
    truth = exact.render(snapshot(), Role.SENDER, 0).astype(int)
    flat = (slice(5, 40), slice(5, -5))
    for image in images:
        error = (image - truth)[flat]
        assert np.std(error) == pytest.approx(1000.0 * 0.005 * 1.6**2, rel=0.1)
    assert np.any(images[0] != images[1])
    again = renderers(SensorNoise())[1].render(snapshot(), Role.SENDER, 1)
    np.testing.assert_array_equal(again, images[0])


def test_holes_can_be_ordered_over_targets() -> None:
    _, depth = renderers(NOISE_FREE)
    plain = depth.render(snapshot(), Role.SENDER, 0)
    holes = depth.render(snapshot(depth_holes=True), Role.SENDER, 0)
    assert (plain > 0).all()
    assert 0.005 < (holes == 0).mean() < 0.3
