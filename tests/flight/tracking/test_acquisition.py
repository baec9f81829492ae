"""What D1 takes for its target: one alone at the designated place, in a box no larger than the target can be."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import pytest

from drivers.interfaces import View
from flight.config import Designated
from flight.guidance import Vec3
from flight.tracking.acquisition import STEADY_FRAMES, Acquisition
from path.config import EvidenceConfig, MethodConfig
from path.geometry.transforms import Pose
from path.observations import Box, Depth, Detection, Region
from tests.flight.following_bench import CAMERA, MOUNT

PERSON = MethodConfig(evidence=EvidenceConfig(span_m=0.77, height_m=1.75))
PLACE: Vec3 = (4.0, 0.0, -0.9)
T_N_C = Pose(MOUNT.T_b_c.R, MOUNT.T_b_c.t + np.array((1.8, 0.0, -3.5)))


@dataclass
class Boxes:
    """A view in which the detector has these boxes, all as far away."""

    boxes: list[Box]
    z_m: float

    def targets(self, region: Region | None) -> list[Detection]:
        return [Detection(box, 0.9) for box in self.boxes]

    def depth(self, box: Box) -> Depth | None:
        return Depth(self.z_m, 0.01)


ONE_PX, TWO_PX = (120.0, 220.0), (180.0, 300.0)


def box_of(place_n_m: Vec3, sides_px: tuple[float, float]) -> tuple[Box, float]:
    x, y, z = T_N_C.inverse().apply(np.array(place_n_m)).tolist()
    u, v = CAMERA.project_point((x, y, z))
    return Box(u - 0.5 * sides_px[0], v - 0.5 * sides_px[1], *sides_px), z


def taken(
    method: MethodConfig, sides_px: tuple[float, float], others: tuple[Vec3, ...] = ()
) -> tuple[Vec3 | None, bool]:
    """What is taken in the last of the frames that it takes, and whether two were seen."""
    box, z_m = box_of(PLACE, sides_px)
    boxes = [box, *(box_of(place, sides_px)[0] for place in others)]
    acquisition, found = Acquisition(CAMERA, method), None
    for _ in range(STEADY_FRAMES):
        view = cast("Any", Boxes(boxes, z_m))
        found = acquisition.look(cast("View", view), T_N_C, Designated(PLACE, 0.9, 0.0))
    return found, acquisition.ambiguous


def test_one_alone_is_taken_where_it_is() -> None:
    found, ambiguous = taken(PERSON, ONE_PX)
    assert found is not None
    assert math.dist(found, PLACE) < 0.05
    assert not ambiguous


def test_two_in_one_box_are_not_taken() -> None:
    """1 m wide: more than somebody who fits into a cylinder of 0.77 m can fill."""
    assert taken(PERSON, TWO_PX) == (None, False)


@dataclass
class BoxInABox(Boxes):
    """The second box lies in the first, and is of something at another depth."""

    behind_m: float = 0.0

    def depth(self, box: Box) -> Depth | None:
        return Depth(self.z_m + (self.behind_m if box is self.boxes[1] else 0.0), 0.01)


@pytest.mark.parametrize(
    ("behind_m", "inside", "sure"), [(1.7, True, False), (-1.2, True, False), (0.3, True, True), (1.7, False, True)]
)
def test_a_box_with_somebody_farther_off_in_it_is_of_two(behind_m: float, inside: bool, sure: bool) -> None:
    """A detector gave one box around two and another around the one behind, in the upper right of the first."""
    box, z_m = box_of(PLACE, ONE_PX)
    other = Box(box.x + (0.4 if inside else 0.8) * box.w, box.y - 0.5, 0.58 * box.w, 0.5 * box.h)
    acquisition, found = Acquisition(CAMERA, PERSON), None
    for _ in range(STEADY_FRAMES):
        view = cast("Any", BoxInABox([box, other], z_m, behind_m))
        found = acquisition.look(cast("View", view), T_N_C, Designated(PLACE, 0.3, 0.0))
    assert (found is not None) == sure


def test_without_a_stated_size_any_box_is_the_objects() -> None:
    assert taken(MethodConfig(), TWO_PX)[0] is not None


@pytest.mark.parametrize(("beside_m", "two"), [(0.6, True), (2.5, False)])
def test_two_that_it_can_be_are_told(beside_m: float, two: bool) -> None:
    found, ambiguous = taken(PERSON, ONE_PX, ((4.0, beside_m, -0.9),))
    assert ambiguous is two
    assert (found is None) is two
