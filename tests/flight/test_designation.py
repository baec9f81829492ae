"""Which object is acquired, in the traffic of many seeds: the one that is meant, or none, however
it moves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest

from drivers.operator.interfaces import PlaceTold
from flight.config import MissionConfig, TargetDesignation, off_from
from flight.guidance import Vec3
from flight.tracking.acquisition import Acquisition, Taken
from hil.world.targets import GroundVehicles, LookAlikeConfig, TargetConfig
from path.config import MethodConfig
from path.geometry.transforms import Pose
from tests.flight.following_bench import CAMERA, MOUNT, Seen

SEEDS = 60
FRAME_S = 0.1
WATCHED_FROM_S = 8.0
WATCHED_UNTIL_S = 20.0
OWN_M = 0.12  # what D1's own position wanders by, per axis
CREW = TargetDesignation(fastest_mps=0.5)
MISSION = MissionConfig(target=CREW)


@dataclass(frozen=True)
class Pointing:
    """Somebody who points every so often, as the simulated person of the rigs does."""

    every_s: float = 3.0
    lasting_m: float = 0.2
    each_m: float = 0.15
    late_s: float = 0.6


def acquired(
    seed: int,
    target: TargetConfig,
    pointing: Pointing | None,
    up: float = 1.6,
    told: TargetDesignation = CREW,
) -> tuple[int | None, float]:
    """Which object (0: the target) D1 takes from behind where it is said to be, and when; None:
    none.
    """
    rng = np.random.default_rng(10_000 + seed)
    homes = [(0.0, 0.0), (1.5, -3.0)]
    traffic = GroundVehicles(target, LookAlikeConfig(), homes, np.random.SeedSequence(seed))
    acquisition = Acquisition(CAMERA, MethodConfig(), replace(MISSION, target=told))
    acquisition.tell(told.told(0))
    off = np.array([*rng.normal(0.0, OWN_M, 2).tolist(), 0.0])
    lasting = rng.normal(0.0, 1.0 if pointing is None else pointing.lasting_m, 2)
    says_s = 0.0
    for k in range(round(WATCHED_UNTIL_S / FRAME_S)):
        time_s = k * FRAME_S
        stamp_ns = round(time_s * 1e9)
        if pointing is not None and time_s >= says_s:
            says_s += pointing.every_s
            east, north, _ = traffic.at(max(0.0, time_s - pointing.late_s))[0].position_w_m
            said = np.array((north, east)) + lasting + rng.normal(0.0, pointing.each_m, 2) + off[:2]
            acquisition.tell(PlaceTold(stamp_ns, (float(said[0]), float(said[1]), -0.1), 0.3))
        if time_s < WATCHED_FROM_S:
            continue
        where = acquisition.where(stamp_ns)
        assert where is not None
        (north, east, _), radius_m = where
        nearer = 1.0 if radius_m < 0.3 else up  # once it is sure
        at = np.array((north - 1.45 * nearer, east, -0.1 - 1.4 * nearer)) - off
        true = Pose(MOUNT.T_b_c.R, MOUNT.T_b_c.t + at)
        objects: list[Vec3] = [
            (o.position_w_m[1], o.position_w_m[0], -0.1) for o in traffic.at(time_s)
        ]
        view = Seen(stamp_ns, objects, true, rng)
        taken = acquisition.look(view, Pose(true.R, true.t + off))
        if isinstance(taken, Taken):
            place = np.array(taken.position_n_m) - off
            return min(
                range(len(objects)), key=lambda j: math.dist(objects[j], place.tolist())
            ), time_s
    return None, WATCHED_UNTIL_S


DRIVES = TargetConfig()
DRIFTS = TargetConfig(speed_mps=0.1, radius_m=3.0, stands_s=(0.0, 0.0))
WALKS = TargetConfig(speed_mps=0.45, radius_m=6.0)


@pytest.mark.parametrize("target", [DRIVES, DRIFTS, WALKS], ids=["drives", "drifts", "faster"])
def test_one_that_moves_from_the_start_is_never_taken_for_another_where_only_an_old_place_is_known(
    target: TargetConfig,
) -> None:
    assert {acquired(seed, target, None)[0] for seed in range(SEEDS)} <= {0, None}


@pytest.mark.parametrize("target", [DRIVES, DRIFTS, WALKS], ids=["drives", "drifts", "faster"])
def test_with_somebody_who_goes_on_pointing_it_is_acquired_and_nothing_else(
    target: TargetConfig,
) -> None:
    taken = [acquired(seed, target, Pointing())[0] for seed in range(SEEDS)]
    assert set(taken) <= {0, None}
    assert taken.count(0) >= 0.5 * SEEDS  # without anybody who answers


def test_a_parked_one_whose_place_is_measured_is_acquired() -> None:
    parked = TargetConfig(start_time_s=60.0)
    measured = replace(CREW, error_m=0.15, holds_s=60.0)
    taken = [acquired(seed, parked, None, told=measured)[0] for seed in range(SEEDS)]
    assert set(taken) <= {0, None}
    assert taken.count(0) >= 0.9 * SEEDS


def test_a_place_that_is_said_to_hold_for_ever_takes_the_look_alike_that_comes_to_it() -> None:
    """The wrong objects that nobody may claim more for than is known."""
    stale = replace(CREW, error_m=0.15, holds_s=3600.0)
    taken = [acquired(seed, DRIVES, None, told=stale)[0] for seed in range(SEEDS)]
    assert sum(who not in (0, None) for who in taken) > 0.1 * SEEDS


def test_what_a_position_is_off_at_home_is_known() -> None:
    assert off_from((1.0, -2.0), (1.4, -2.7, 0.1)) == pytest.approx((0.4, -0.7))
    assert off_from(None, (1.4, -2.7, 0.1)) == off_from((), (1.4, -2.7, 0.1)) == (0.0, 0.0)


def test_a_designation_is_a_statement_about_the_instant_at_which_it_was_made() -> None:
    said = TargetDesignation(
        north_m=3.0, age_s=2.0, error_m=0.4, velocity_mps=(0.2, 0.1), holds_s=5.0
    )
    told = said.told(10_000_000_000)
    assert told == PlaceTold(8_000_000_000, (3.0, 0.0, -0.1), 0.4, False, (0.2, 0.1), 5.0)
    with pytest.raises(ValueError, match="two numbers"):
        TargetDesignation(velocity_mps=(1.0,))
