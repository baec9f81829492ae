"""D1 behind its target, closed loop: comes to rest at its place, and keeps in view what drives,
turns and stops.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from drivers.interfaces import VehicleState, VelocitySetpoint
from flight.config import MissionConfig
from flight.guidance import Answer, Vec3, add, approach, close_in, norm, subtract
from flight.tracking.target_track import TargetTrack
from tests.flight.following_bench import Course, Followed, follow_course

CONFIG = MissionConfig()
KEEP = CONFIG.follow


def place_behind(target_n_m: Vec3) -> Vec3:
    return add(target_n_m, (-KEEP.behind_m, 0.0, -(KEEP.height_m - 0.1)))


def guidance(state: VehicleState, track: TargetTrack, now_ns: int) -> VelocitySetpoint:
    """As the sender's."""
    target, (north, east, _) = track.believed(now_ns)
    error = subtract(place_behind(target), state.position_n_m)
    velocity = approach(
        error, state.velocity_n_mps, (north, east, 0.0), KEEP.answer(CONFIG.max_accel_mps2)
    )
    return VelocitySetpoint(velocity, 0.0)


def in_proportion(state: VehicleState, track: TargetTrack, now_ns: int) -> VelocitySetpoint:
    """The approach that overshoots: in proportion to the way that is left, whatever the vehicle
    does meanwhile.
    """
    target, _ = track.predict(now_ns)
    north, east, _ = track.velocity_n_mps
    error = subtract(place_behind(target), state.position_n_m)
    return VelocitySetpoint(
        close_in(error, (north, east, 0.0), KEEP.gain_per_s, KEEP.max_speed_mps), 0.0
    )


def standing(_: float) -> tuple[float, float]:
    return 4.0, 0.0


def driving(speed_mps: float, heading_rad: float) -> Course:
    """From a standstill at 3 s, at 0.6 m/s^2."""

    def at(time_s: float) -> tuple[float, float]:
        way = _way(time_s - 3.0, speed_mps)
        return 4.0 + way * math.cos(heading_rad), way * math.sin(heading_rad)

    return at


def turning(speed_mps: float, radius_m: float) -> Course:
    def at(time_s: float) -> tuple[float, float]:
        angle = _way(time_s - 3.0, speed_mps) / radius_m
        return 4.0 + radius_m * math.sin(angle), radius_m * (1.0 - math.cos(angle))

    return at


def _way(time_s: float, speed_mps: float, accel_mps2: float = 0.6) -> float:
    time_s = max(0.0, time_s)
    since_s = max(0.0, time_s - speed_mps / accel_mps2)
    return 0.5 * accel_mps2 * (time_s - since_s) ** 2 + speed_mps * since_s


# --- a step: the target stands, the drone comes fast


# north, east, height, speed at acquisition
FAST = [(1.3, 0.0, 1.5, 0.9), (1.5, 0.0, 1.4, 0.8), (1.7, 0.0, 1.6, 0.6)]


@pytest.mark.parametrize("start", FAST)
@pytest.mark.parametrize("seed", range(3))
def test_a_drone_that_comes_fast_stops_at_its_place(
    start: tuple[float, float, float, float], seed: int
) -> None:
    flown = follow_course(
        standing, guidance, CONFIG, start=start, seed=seed, last_s=10.0, wind=(0.5, 1.4, 0.0)
    )
    assert flown.nearest_m > KEEP.behind_m - 0.12
    assert flown.out_of_view_s == 0.0 and flown.lost_s == 0.0
    assert abs(flown.off_m[-50:, 0].mean() - KEEP.behind_m) < 0.1  # tilts are half a degree off


def test_a_command_in_proportion_to_the_way_overshoots() -> None:
    """The bench shows the fault that the approach is made against."""
    flown = [
        follow_course(standing, in_proportion, CONFIG, start=start, last_s=6.0) for start in FAST
    ]
    assert min(each.nearest_m for each in flown) < KEEP.behind_m - 0.2


# --- ramps and turns


def worst(course: Course) -> tuple[float, float]:
    """Longest time out of view, and largest distance from the place behind the target, of three
    flights.
    """
    flown: list[Followed] = [
        follow_course(course, guidance, CONFIG, start=(2.55, 0.0, 1.5, 0.0), seed=seed, last_s=14.0)
        for seed in range(3)
    ]
    off_m = max(float(np.hypot(f.off_m[:, 0] - KEEP.behind_m, f.off_m[:, 1]).max()) for f in flown)
    return max(each.out_of_view_s for each in flown), off_m


@pytest.mark.parametrize("heading_deg", [0.0, 90.0, -135.0, 180.0])
def test_a_target_that_drives_off_stays_in_view(heading_deg: float) -> None:
    out_s, off_m = worst(driving(0.3, math.radians(heading_deg)))
    assert out_s == 0.0
    assert off_m < 0.45


def test_a_target_that_turns_stays_in_view() -> None:
    out_s, off_m = worst(turning(0.3, 1.5))
    assert out_s == 0.0
    assert off_m < 0.45


def test_a_tight_turn_at_twice_the_speed_stays_in_view() -> None:
    out_s, off_m = worst(turning(0.6, 1.5))
    assert out_s == 0.0
    assert off_m < 0.65


# --- the law


def test_nothing_is_faster_than_it_can_stop() -> None:
    answer = Answer(gain_per_s=1.0, max_speed_mps=9.0, response_s=1.0, accel_mps2=0.8)
    for way_m in (0.1, 0.5, 1.0, 3.0, 10.0):
        speed = norm(approach((way_m, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), answer))
        assert speed**2 / answer.accel_mps2 <= way_m + 1e-9  # with half of it


def test_a_drone_that_keeps_up_with_its_place_goes_on_as_it_does() -> None:
    answer = KEEP.answer(0.8)
    assert approach((0.0, 0.0, 0.0), (0.4, 0.1, 0.0), (0.4, 0.1, 0.0), answer) == pytest.approx(
        (0.4, 0.1, 0.0)
    )
