"""A drone that lands goes first where the target cannot be by then."""

from __future__ import annotations

import pytest

from flight.config import MissionConfig
from flight.tracking.target_track import TargetTrack
from flight.way_out import FARTHEST, LANDING_MPS, way_out_m

CONFIG = MissionConfig()
BACK = (-1.0, 0.0, 0.0)


def away_m(speed_mps: float, height_m: float, least_m: float = 1.8) -> float:
    track = TargetTrack((1.5, 0.0, 0.0), 0)
    for tick in range(1, 200):
        track.update((1.5 - speed_mps * 0.02 * tick, 0.0, 0.0), tick * 20_000_000)
    target, _ = track.believed(track.stamp_ns)
    place = (target[0] - 1.5, 0.0, -height_m)
    return way_out_m(track, place, BACK, CONFIG, track.stamp_ns, least_m)


def test_it_is_the_usual_way_from_a_target_that_stands() -> None:
    assert away_m(0.0, 0.0, least_m=2.5) == pytest.approx(2.5)


def test_it_is_farther_the_faster_the_target_and_the_longer_the_landing() -> None:
    assert away_m(0.2, 1.0) <= away_m(0.4, 1.0) <= away_m(0.8, 1.0)
    assert away_m(0.3, 0.5) <= away_m(0.3, 2.0)
    assert away_m(0.8, 2.0) > away_m(0.0, 0.5)


def test_what_runs_after_it_is_not_fled_from_for_ever() -> None:
    assert away_m(5.0, 5.0) == pytest.approx(FARTHEST * CONFIG.depart_m)


def test_the_target_cannot_come_there_while_it_lands() -> None:
    speed_mps, height_m = 0.1, 0.5
    distance_m = 1.5 + away_m(speed_mps, height_m)
    landing_s = CONFIG.depart_m / CONFIG.follow.max_speed_mps + height_m / LANDING_MPS
    assert distance_m - speed_mps * landing_s > CONFIG.separation.minimum_m
