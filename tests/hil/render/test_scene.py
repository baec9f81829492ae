"""The bodies have the size and the faces they should."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from numpy.typing import NDArray

from hil.render.bodies.kinds import BOXES, DRONE_HULL, DRONE_LIMBS, Boxes, model_of_thing
from hil.render.scene import GAP_M, MARKER, PAPER, SOLID, Model, box, car, drone, marked_drone
from hil.render.textures import GROUND_LEVELS, GROUND_SIZE, ground_pyramid
from hil.world.snapshot import ObjectTruth, TargetKind
from path.marker.layout import single_marker
from tests.hil.render.views import TAIL

Array = NDArray[np.float64]


def vertices(model: Model) -> Array:
    c = model.corners
    return np.concatenate(
        [c[:, :3] + a * c[:, 3:6] + b * c[:, 6:9] for a in (0, 1) for b in (0, 1)]
    )


def test_box_faces_look_outward_and_close() -> None:
    center = np.array([0.3, -0.2, 0.5])
    faces = box(center, (0.2, 0.4, 0.6), (1.0, 2.0, 3.0))
    areas = 0.0
    for p0, e1, e2, *_ in faces:
        towards_viewer = -np.cross(e1, e2)
        middle = p0 + 0.5 * (e1 + e2)
        assert towards_viewer @ (middle - center) > 0.0
        areas += float(np.linalg.norm(towards_viewer))
    assert areas == pytest.approx(2 * (0.2 * 0.4 + 0.4 * 0.6 + 0.2 * 0.6))


def test_car_has_its_size() -> None:
    points = vertices(car())
    assert np.ptp(points, axis=0) == pytest.approx((0.32, 0.22, 0.16), abs=0.003)
    assert points[:, 2].min() >= GAP_M - 1e-9
    assert points[:, 1].min() == pytest.approx(-points[:, 1].max())


@pytest.mark.parametrize("parts", [BOXES["car"], (*DRONE_HULL, *DRONE_LIMBS)])
def test_parts_of_what_is_tracked_do_not_touch(parts: Boxes) -> None:
    for (center, size, _), (other, other_size, _) in combinations(parts, 2):
        apart = np.abs(np.subtract(center, other)) - 0.5 * np.add(size, other_size)
        assert apart.max() >= GAP_M - 1e-9


@pytest.mark.parametrize(("kind", "height_m"), [("car", 0.16), ("person", 1.75)])
def test_cameras_see_the_boxes_that_geometry_reckons_with(
    kind: TargetKind, height_m: float
) -> None:
    points = vertices(model_of_thing(kind, ObjectTruth(3, (0.0, 0.0, 0.0), 0.0, 0.0)))
    ends = np.array(
        [np.add(c, np.multiply(half, s)) for c, s, _ in BOXES[kind] for half in (-0.5, 0.5)]
    )
    assert np.ptp(ends[:, 2]) == pytest.approx(height_m, abs=0.01)
    # of people who walk, tests/hil/render/test_walking.py has the depth
    own = slice(1 if kind == "person" else 0, 3)
    spans = np.ptp(ends, axis=0)[own]
    # people are not quite alike
    assert np.ptp(points, axis=0)[own] == pytest.approx(spans, rel=0.08)


def test_plate_carries_the_marker_with_a_white_border() -> None:
    layout = single_marker(0.04)
    model = marked_drone(TAIL, layout, hidden=False)
    (index,) = np.flatnonzero(model.kinds == MARKER)
    p0, e1, e2 = model.corners[index].reshape(3, 3)
    assert np.linalg.norm(e1) == pytest.approx(0.06)
    assert np.linalg.norm(e2) == pytest.approx(0.06)
    assert p0 + 0.5 * (e1 + e2) == pytest.approx(TAIL.t)
    # the marker's own top left corner, 1/6 into the plate each way
    assert p0 + (e1 + e2) / 6.0 == pytest.approx(TAIL.apply(layout.markers[0].corners_v[0]))
    assert -np.cross(e1, e2) / 0.06**2 == pytest.approx(TAIL.R[:, 2])
    assert model.cells[0, 0].max() == 0  # black frame
    assert model.cells[0, 1:-1, 1:-1].any()


def test_a_hidden_marker_leaves_a_white_plate() -> None:
    model = marked_drone(TAIL, single_marker(), hidden=True)
    assert not (model.kinds == MARKER).any()
    white = np.all(model.colors == PAPER, axis=1)
    assert model.kinds[white].tolist() == [SOLID]
    assert len(model.kinds) == len(marked_drone(TAIL, single_marker(), hidden=False).kinds)
    assert len(model.kinds) > len(drone().kinds)


def test_mip_levels_keep_the_mean_and_words_hold_the_neighbours() -> None:
    pyramid = ground_pyramid().view(np.uint32)
    first, means = 0, []
    for level in range(GROUND_LEVELS):
        size = GROUND_SIZE >> level
        words = pyramid[first : first + size * size].reshape(size, size)
        texels = words & 255
        assert np.array_equal(words >> 8 & 255, np.roll(texels, -1, axis=1))
        assert np.array_equal(words >> 16 & 255, np.roll(texels, -1, axis=0))
        assert np.array_equal(words >> 24, np.roll(texels, (-1, -1), axis=(0, 1)))
        means.append(texels.mean())
        first += size * size
    assert first == pyramid.size
    assert np.ptp(means) < 1.0
