"""Bodies of any stated size: what the geometry and the cameras see of them grows with it."""

from __future__ import annotations

import numpy as np
import pytest

from hil.geometric.scene import parts_of
from hil.render.bodies.kinds import model_of_thing
from hil.world.snapshot import AS_IT_IS, OWN_SIZE_M, ObjectTruth, TargetKind, stretch_of
from hil.world.targets import TargetConfig

THING = ObjectTruth(0, (0.0, 0.0, 0.0), 0.0, 0.0)


def extent(kind: TargetKind, size_m: tuple[float, float, float] | None) -> np.ndarray:
    corners = model_of_thing(kind, THING, stretch_of(kind, size_m)).corners.reshape(-1, 3, 3)
    points = np.concatenate([corners[:, 0], corners[:, 0] + corners[:, 1] + corners[:, 2]])
    return points.max(axis=0) - points.min(axis=0)


@pytest.mark.parametrize("kind", ["car", "drone"])
def test_a_body_is_drawn_as_large_as_it_is_stated(kind: TargetKind) -> None:
    stated = (4.5, 1.8, 1.5)
    assert extent(kind, stated)[:2] == pytest.approx(stated[:2], rel=0.02)
    assert extent(kind, OWN_SIZE_M[kind]) == pytest.approx(extent(kind, None))


def test_a_child_is_a_person_of_its_height_in_the_shape_of_a_person() -> None:
    child = extent("person", (0.4, 0.35, 1.1))
    grown = extent("person", None)
    assert child[2] == pytest.approx(grown[2] * 1.1 / 1.75, rel=1e-6)
    assert child / grown == pytest.approx(np.full(3, 1.1 / 1.75))


@pytest.mark.parametrize("kind", ["car", "person", "drone"])
def test_the_geometry_reckons_with_the_same_body(kind: TargetKind) -> None:
    stretch = stretch_of(kind, (1.2, 0.9, 2.4))
    plain, grown = parts_of(kind), parts_of(kind, stretch)
    assert grown[:, :3] == pytest.approx(plain[:, :3] * stretch)
    assert grown[:, 3:6] == pytest.approx(plain[:, 3:6] * stretch)
    assert np.array_equal(grown[:, 6:], plain[:, 6:])


def test_a_target_of_no_stated_size_is_as_it_always_was() -> None:
    assert TargetConfig().stretch == AS_IT_IS
    assert parts_of("car", AS_IT_IS) == pytest.approx(parts_of("car"))
