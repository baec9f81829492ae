"""People have the size of people, differ a little, and a colour detector that knows nothing of them
finds them.
"""

from __future__ import annotations

import numpy as np
import pytest

from drivers.detectors.color import ColorDetector, ColorDetectorConfig
from flight.harness.renderer import Imaging, RenderedInstant, RendererSetup, Thing
from hil.camera.pictures import CameraRenderer
from hil.render.bodies.people import HEIGHT_M, PARTS, person
from hil.render.scene import GAP_M, PATTERN
from path.camera.model import CameraModel
from path.marker.layout import single_marker
from path.messages import Role
from tests.hil.render.test_scene import vertices
from tests.hil.render.views import TAIL, hovering, mount

HD = CameraModel(1280, 720, 920.0, 920.0, 640.0, 360.0)


@pytest.mark.parametrize("variant", range(7))
def test_people_stand_on_the_ground_and_are_as_tall_as_people(variant: int) -> None:
    points = vertices(person(variant))
    assert 0.0 < points[:, 2].min() < 0.01
    assert points[:, 2].max() == pytest.approx(HEIGHT_M, rel=0.045)
    assert 0.55 < np.ptp(points[:, 1]) < 0.80
    assert np.abs(points[:, 1].max() + points[:, 1].min()) < 1e-9


def test_parts_of_all_variants_keep_apart() -> None:
    for variant in range(7):
        points = vertices(person(variant)).reshape(4, len(PARTS), 6, 3)
        low, high = points.min(axis=(0, 2)), points.max(axis=(0, 2))
        for a in range(len(PARTS)):
            apart = np.maximum(low[a] - high, low - high[a]).max(axis=1)
            assert np.delete(apart, a).min() >= GAP_M - 1e-9, (variant, a)


def test_variants_are_alike_but_not_the_same() -> None:
    one, other = person(0), person(1)
    assert one.kinds.tolist() == other.kinds.tolist()
    assert np.abs(one.corners - other.corners).max() > 0.01
    assert np.abs(one.colors - other.colors).max() < 40.0
    shares = [
        float(np.mean(a != b)) for a, b in zip(one.shades, other.shades, strict=True) if a.size > 30
    ]
    assert 0.05 < np.mean(shares) < 0.30  # both flip 8 %
    assert person(1) is other


def test_patterns_have_contrast_and_corners() -> None:
    model = person(2)
    patterned = model.kinds == PATTERN
    assert patterned.sum() == len(model.shades) > 40
    grey = np.array([0.114, 0.587, 0.299])
    contrast = np.abs((model.colors - model.seconds)[patterned] @ grey)
    assert np.median(contrast) > 30.0
    assert sum(table.size for table in model.shades) > 1500


@pytest.mark.parametrize("distance_m", [3.0, 5.0, 8.0])
def test_the_colour_detector_finds_a_person_from_pixels_alone(distance_m: float) -> None:
    renderer = CameraRenderer(RendererSetup(HD, mount(20.0), TAIL, single_marker(), Imaging()), 1)
    detector = ColorDetector(ColorDetectorConfig())
    height_m = 1.1 + distance_m * np.tan(np.radians(20.0))
    for number, yaw_rad in enumerate(np.radians([-90.0, -40.0, 20.0, 90.0, 170.0])):
        thing = Thing("person", (0.2, distance_m, 0.0), float(yaw_rad), number)
        stage = RenderedInstant({Role.RECEIVER: hovering(0.0, 0.0, float(height_m))}, (thing,))
        (found,) = detector.detect(renderer.shoot(stage, Role.RECEIVER, number).color, None)
        u, v = found.box.center
        assert found.score > 0.5
        assert u == pytest.approx(640.0 + 920.0 * 0.2 / distance_m, abs=0.1 * 920.0 / distance_m)
        assert v == pytest.approx(360.0, abs=0.15 * 920.0 / distance_m)
        px_per_m = 920.0 / np.hypot(distance_m, height_m - 1.1)
        assert 0.28 < found.box.w / px_per_m < 0.80
        assert 0.5 < found.box.h / px_per_m < 0.85
