"""The ranges that a drone asks for: when, and what they are by where its rays come down to the
ground.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from flight.config import MissionConfig
from flight.tracking.ranging import Ground, Ranging
from flight.tracking.target_track import TargetTrack
from path.camera.model import CameraModel
from path.config import MethodConfig
from path.geometry.transforms import Pose
from path.observations import Box, Depth, RangeSource
from path.target.range import Body
from tests.flight.tracking.test_association import CAMERA, PLACE, SECOND, T_N_C, FakeView, tracked

MISSION = replace(MissionConfig(), height_sigma_m=0.04, attitude_sigma_deg=1.0)
LEVEL = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
TELLO = CameraModel(960, 720, 920.0, 920.0, 480.0, 360.0, (0.0, 0.0, 0.0, 0.0, 0.0))


class Coarse(FakeView):
    """Ranges by the object's size, a fifth too far; of what is true the view below has it to a
    centimetre.
    """

    def depth(self, box: Box) -> Depth | None:
        true = super().depth(box)
        return None if true is None else Depth(1.2 * true.z_m, 0.1 * true.z_m, RangeSource.SIZE)


def depths(mission: MissionConfig) -> tuple[Depth, Depth, Depth]:
    """Of a target: in truth, of its sighting, and of what stands beside it against the truth of
    that.
    """
    other = (2.0, 0.5, -0.1)
    ranging = Ranging.of(mission, MethodConfig())
    track, view = (
        TargetTrack.of(mission, PLACE, 0, ranging=ranging),
        Coarse([PLACE, other], SECOND // 50),
    )
    seen = tracked(view, track)
    true = FakeView([PLACE, other]).depth(seen.box)
    (rival,) = seen.beside
    assert seen.depth is not None and true is not None and rival.depth is not None
    return true, seen.depth, rival.depth


def test_an_estimated_range_is_bettered_by_the_height_of_the_drone() -> None:
    true, found, beside = depths(MISSION)
    assert found.z_m == pytest.approx(true.z_m, rel=0.03)
    # it stands as far away, and on the same ground
    assert beside.z_m == pytest.approx(true.z_m, rel=0.06)
    assert abs(found.z_m - true.z_m) < 2.0 * found.sigma_m < 0.1 * true.z_m


@pytest.mark.parametrize("flies", [False, True])
def test_nothing_is_said_where_no_height_is_known_or_the_target_flies(flies: bool) -> None:
    mission = (
        replace(MISSION, target=replace(MISSION.target, flies=True)) if flies else MissionConfig()
    )
    true, found, _ = depths(mission)
    assert found.z_m == pytest.approx(1.2 * true.z_m)


# --- when which is asked ---

PERSON = Body(0.78, 1.75)
LOOKING_DOWN = Pose(
    np.array(
        [
            [0.0, -math.sqrt(0.5), math.sqrt(0.5)],
            [1.0, 0.0, 0.0],
            [0.0, math.sqrt(0.5), math.sqrt(0.5)],
        ]
    ),
    np.array([0.0, 0.0, -6.5]),
)
BOX = Box(440.0, 260.0, 80.0, 200.0)


def ranging(**changed: object) -> Ranging:
    usual = Ranging(0.875, math.radians(0.6), 1.5, PERSON, Ground(0.0, 0.3), 6.0)
    return replace(usual, **changed)


def by(known: Ranging, depth: Depth | None, expected_m: float = 8.0) -> tuple[RangeSource, ...]:
    found = known.ranged(depth, BOX, TELLO, LOOKING_DOWN, expected_m)
    return () if found is None else found.by


def test_beyond_the_reach_of_depth_the_ground_and_the_size_stand_in() -> None:
    assert by(ranging(), None) == (RangeSource.GROUND, RangeSource.SIZE)
    assert by(ranging(ground=None), None) == (RangeSource.SIZE,)
    assert by(ranging(body=Body()), None) == (RangeSource.GROUND,)
    assert by(ranging(body=Body(), ground=None), None) == ()


def test_a_hole_within_the_reach_of_depth_stays_a_miss() -> None:
    assert by(ranging(), None, 5.0) == ()


def test_a_depth_that_is_measured_is_not_held_against_a_box_of_which_a_part_may_be_hidden() -> None:
    assert by(ranging(ground=None), Depth(8.0, 0.2)) == (RangeSource.DEPTH,)
    assert by(ranging(ground=None), Depth(8.0, 0.8)) == (RangeSource.SIZE, RangeSource.DEPTH)


def test_a_rangefinder_says_so_and_what_contradicts_it_is_told() -> None:
    ground = Ground(0.0, 0.05, RangeSource.RANGEFINDER)
    assert by(ranging(ground=ground), None)[0] is RangeSource.RANGEFINDER
    found = ranging(ground=ground).ranged(Depth(20.0, 1.5), BOX, TELLO, LOOKING_DOWN, 8.0)
    assert found is not None
    assert found.against == (RangeSource.DEPTH,)
    assert found.depth.z_m < 9.0


def test_the_ground_is_where_the_rig_states_how_well_the_height_is_known() -> None:
    assert Ranging.of(MISSION, MethodConfig()).ground == Ground(0.0, 0.04)
    assert Ranging.of(MissionConfig(), MethodConfig()).ground is None
    flies = replace(MISSION, target=replace(MISSION.target, flies=True))
    assert Ranging.of(flies, MethodConfig()).ground is None


def test_a_ray_that_hardly_comes_down_is_left_to_the_others() -> None:
    level, depth = Pose(LEVEL, np.array([0.0, 0.0, -1.0])), Depth(3.0, 0.3)
    found = ranging(body=Body()).ranged(depth, Box(450.0, 340.0, 60.0, 40.0), TELLO, level, 3.0)
    assert found is not None and found.depth is depth
    from_below = Pose(T_N_C.R, np.array([0.0, 0.0, 0.5]))
    found = ranging(body=Body()).ranged(
        depth, Box(300.0, 240.0, 40.0, 40.0), CAMERA, from_below, 3.0
    )
    assert found is not None and found.depth is depth
