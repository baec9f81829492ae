"""A drone that finds nothing at the designated place looks at it from other sides, and keeps the
one that shows it.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from drivers.operator.interfaces import PlaceTold
from flight.config import FollowConfig, GuardConfig, MissionConfig, TargetDesignation
from flight.guidance import Vec3, add, from_heading
from flight.tracking.acquisition import Acquisition
from flight.tracking.look_round import LookRound
from path.config import MethodConfig
from path.geometry.rotation import R_from_rpy
from path.geometry.transforms import Pose
from tests.flight.following_bench import CAMERA, MOUNT, Seen

CONFIG = MissionConfig(heading_deg=30.0, follow=FollowConfig(behind_m=2.0, look_round_s=3.0))
PLACE: Vec3 = (4.0, 0.0, -0.1)
TICK_NS = 50_000_000


def flown(
    config: MissionConfig, seconds: float, look: LookRound | None = None
) -> list[tuple[float, float]]:
    """(s, degrees from the first heading) of each tick of a drone that has come to its place after
    2 s.
    """
    look = look or LookRound(config)
    told: list[tuple[float, float]] = []
    for k in range(round(seconds * 20)):
        look.step(k * TICK_NS, 0.0 if k >= 40 else 1.0, PLACE)
        told.append((k / 20, round(math.degrees(look.heading_rad) - config.heading_deg, 9)))
    return told


def test_it_hangs_at_its_first_heading_for_a_while_and_then_goes_a_quarter_round_to_both_sides() -> (
    None
):
    told = flown(CONFIG, 40.0)
    assert {round_deg for at_s, round_deg in told if at_s < 5.0} == {0.0}
    rounds = [round_deg for _, round_deg in told]
    assert 85.0 < max(rounds) <= 90.0
    assert -90.0 <= min(rounds) < -85.0
    steps_m = np.abs(np.diff(np.radians(rounds))) * CONFIG.follow.behind_m
    assert (
        steps_m.max() * 20 < math.sqrt(0.5 * CONFIG.max_accel_mps2 * CONFIG.follow.behind_m) + 1e-6
    )


@pytest.mark.parametrize(
    "config",
    [
        replace(CONFIG, follow=replace(CONFIG.follow, look_round_s=0.0)),
        replace(CONFIG, follow=replace(CONFIG.follow, behind_m=0.0)),
        replace(CONFIG, target=TargetDesignation(flies=True)),
    ],
    ids=["told not to", "from straight above", "round what flies"],
)
def test_it_stays_where_it_is(config: MissionConfig) -> None:
    assert {round_deg for _, round_deg in flown(config, 30.0)} == {0.0}


def test_it_stays_inside_its_fence() -> None:
    config = replace(CONFIG, heading_deg=0.0, guard=GuardConfig(fence_radius_m=4.7))
    told = [math.radians(round_deg) for _, round_deg in flown(config, 40.0)]
    places = [add(PLACE, from_heading((-2.0, 0.0, 0.0), heading)) for heading in told]
    assert max(math.hypot(north, east) for north, east, _ in places) <= 3.7
    assert max(told) > 0.5
    assert min(told) < -0.5


def test_where_two_may_be_the_designated_one_it_goes_no_farther() -> None:
    look = LookRound(CONFIG)
    look.hold()  # on its way: those it saw from afar
    assert flown(CONFIG, 8.0, look)[-1][1] > 20.0
    at = look.heading_rad
    look.hold()
    assert flown(CONFIG, 30.0, look)[-1][1] == pytest.approx(math.degrees(at) - 30.0)
    assert look.velocity_n_mps == (0.0, 0.0, 0.0)


def test_a_target_that_is_seen_from_one_side_only_is_found_from_there_and_the_heading_kept() -> (
    None
):
    """The detector knows it from within 25 degrees of the east alone; D1 came from the south."""
    config = MissionConfig(heading_deg=0.0)
    look, acquisition = LookRound(config), Acquisition(CAMERA, MethodConfig(), config)
    acquisition.tell(PlaceTold(0, PLACE, 0.15, holds_s=60.0))
    rng, heading = np.random.default_rng(0), None
    for k in range(round(30.0 * 20)):
        look.step(k * TICK_NS, 0.0, PLACE)
        behind = from_heading(
            (-config.follow.behind_m, 0.0, -(config.follow.height_m - 0.1)), look.heading_rad
        )
        at = add(PLACE, behind)
        R_n_b = R_from_rpy(0.0, 0.0, look.yaw_rad(at, PLACE))
        T_n_c = Pose(R_n_b @ MOUNT.T_b_c.R, np.array(at) + R_n_b @ MOUNT.T_b_c.t)
        from_east_rad = abs(math.atan2(behind[0], behind[1]))
        view = Seen(k * TICK_NS, (PLACE,) if from_east_rad < math.radians(25.0) else (), T_n_c, rng)
        taken = acquisition.look(view, T_n_c)
        if taken is not None:
            heading = look.found(at, taken.position_n_m)
            break
    assert heading is not None
    assert math.degrees(heading) == pytest.approx(-90.0, abs=26.0)
    look.step(10**12, 0.0, PLACE)
    assert (look.heading_rad, look.velocity_n_mps) == (pytest.approx(heading), (0.0, 0.0, 0.0))
