"""The ground below a drone: by its rangefinder, as long as that does not contradict the drone's own
height.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from drivers.interfaces import Below, FlightMode, VehicleState
from drivers.rig.facts import HeightFacts
from flight.ground_below import GroundBelow
from path.geometry.rotation import R_from_rpy, quat_from_R
from path.observations import RangeSource

FACTS = HeightFacts(drift_m=0.3, rangefinder_max_m=12.0, rangefinder_sigma_m=0.05, uneven_m=0.02)
MS = 1_000_000
SECOND = 1000 * MS


def state(
    seconds: float,
    height_m: float,
    below_m: float | None,
    *,
    in_air: bool = True,
    roll_deg: float = 0.0,
) -> VehicleState:
    stamp_ns = round(seconds * SECOND)
    q = quat_from_R(R_from_rpy(math.radians(roll_deg), 0.0, 0.0))
    below = None if below_m is None else Below(stamp_ns, below_m)
    return VehicleState(
        stamp_ns, stamp_ns, (0.0, 0.0, -height_m), (0.0, 0.0, 0.0), q, True, in_air, True, FlightMode.OFFBOARD, 0.9,
        below=below,
    )  # fmt: skip


def flown(facts: HeightFacts, *states: VehicleState) -> tuple[GroundBelow, list[str]]:
    ground = GroundBelow(facts)
    ground.note(state(0.0, 0.0, None, in_air=False))
    return ground, [said for each in states if (said := ground.note(each))]


def scaled(facts: HeightFacts, k: float) -> HeightFacts:
    return HeightFacts(*(k * getattr(facts, name) for name in facts.__slots__))  # type: ignore[attr-defined]


@pytest.mark.parametrize("k", [0.2, 1.0, 5.0, 20.0])
def test_a_height_that_drifts_is_put_right_by_the_rangefinder(k: float) -> None:
    """Half a metre within two minutes at a height of six: the ground is down there by so much
    less.
    """
    states = [
        state(t, k * (6.0 + 0.25 * t / 60.0), k * 6.0) for t in np.arange(1.0, 120.0, 0.1).tolist()
    ]
    ground, said = flown(scaled(FACTS, k), *states)
    assert said == []
    found = ground.ground
    assert found.source is RangeSource.RANGEFINDER
    assert found.down_m == pytest.approx(-0.5 * k, abs=0.03 * k)
    assert found.sigma_m < 0.05 * k


def test_without_a_rangefinder_the_ground_is_where_it_stood_and_the_longer_ago_the_less_is_known() -> (
    None
):
    facts = replace(FACTS, rangefinder_max_m=0.0)
    after = [flown(facts, state(t, 6.0, 6.0))[0].ground for t in (60.0, 240.0)]
    assert [each.source for each in after] == [RangeSource.GROUND] * 2
    assert [each.down_m for each in after] == [0.0, 0.0]
    assert after[0].sigma_m == pytest.approx(0.3, abs=0.01)
    assert after[1].sigma_m == pytest.approx(0.6, abs=0.01)


def test_a_roof_below_it_is_not_believed_told_once_and_told_when_it_is_over() -> None:
    over_ground = [state(0.1 * k, 6.0, 6.0) for k in range(1, 50)]
    over_roof = [state(5.0 + 0.1 * k, 6.0, 3.0) for k in range(50)]
    behind = [state(10.0 + 0.1 * k, 6.0, 6.0) for k in range(10)]
    ground, said = flown(FACTS, *over_ground, *over_roof)
    assert len(said) == 1
    assert "rangefinder says 3.00 m" in said[0] and "own height 6.0" in said[0]
    assert ground.doubted
    assert ground.ground.down_m == pytest.approx(0.0, abs=0.02)
    assert ground.ground.source is RangeSource.GROUND  # it has not measured it for a second
    more = [told for each in behind if (told := ground.note(each))]
    assert more == ["the rangefinder agrees with its own height again"]
    assert not ground.doubted


def test_a_drone_that_leans_measures_along_the_slant() -> None:
    leaning = [
        state(0.1 * k, 6.0, 6.0 / math.cos(math.radians(20.0)), roll_deg=20.0) for k in range(1, 40)
    ]
    ground, said = flown(FACTS, *leaning)
    assert said == []
    assert ground.ground.down_m == pytest.approx(0.0, abs=0.02)
    over = [state(0.1 * k, 6.0, 9.0, roll_deg=60.0) for k in range(1, 40)]
    ground, said = flown(FACTS, *over)
    assert said == [] and ground.ground.source is RangeSource.GROUND


@pytest.mark.parametrize("below_m", [None, 0.05, 12.0, 40.0])
def test_what_is_out_of_its_reach_says_nothing(below_m: float | None) -> None:
    ground, said = flown(FACTS, *(state(0.1 * k, 6.0, below_m) for k in range(1, 30)))
    assert said == []
    assert ground.ground.source is RangeSource.GROUND


def test_one_measurement_counts_once_however_often_the_state_is_looked_at() -> None:
    once = replace(state(1.0, 6.0, 6.02), stamp_ns=2 * SECOND)
    ground, _ = flown(FACTS, once)
    before = ground.ground
    for _ in range(100):
        ground.note(once)
    assert ground.ground == before


def test_it_is_off_by_as_much_as_it_says() -> None:
    rng = np.random.default_rng(2)
    off: list[float] = []
    for _ in range(200):
        drift = np.cumsum(0.3 * math.sqrt(0.1 / 60.0) * rng.standard_normal(300))
        states = [
            state(0.1 * k + 0.1, 6.0 + float(d), 6.0 + 0.05 * float(rng.standard_normal()))
            for k, d in enumerate(drift)
        ]
        facts = replace(FACTS, uneven_m=0.0)
        ground, _ = flown(facts, *states)
        off.append((ground.ground.down_m + float(drift[-1])) / ground.ground.sigma_m)
    assert 0.85 < float(np.std(off)) < 1.15
