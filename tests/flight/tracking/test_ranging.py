"""Ranges that are only estimated, bettered by where a ray comes down to the ground."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from flight.config import MissionConfig
from flight.tracking.ranging import OverGround
from flight.tracking.target_track import TargetTrack
from path.camera.model import CameraModel
from path.geometry.transforms import Pose
from path.observations import Box, Depth
from tests.flight.tracking.test_association import CAMERA, PLACE, SECOND, T_N_C, FakeView, tracked

MISSION = replace(MissionConfig(), height_sigma_m=0.04, attitude_sigma_deg=1.0)
LEVEL = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
TELLO = CameraModel(960, 720, 920.0, 920.0, 480.0, 360.0, (0.0, 0.0, 0.0, 0.0, 0.0))


class Coarse(FakeView):
    """Ranges by the object's size, a fifth too far; of what is true the view below has it to a centimetre."""

    def depth(self, box: Box) -> Depth | None:
        true = super().depth(box)
        return None if true is None else Depth(1.2 * true.z_m, 0.1 * true.z_m)


def depths(mission: MissionConfig) -> tuple[Depth, Depth, Depth]:
    """Of a target: in truth, of its sighting, and of what stands beside it against the truth of that."""
    other = (2.0, 0.5, -0.1)
    track, view = TargetTrack.of(mission, PLACE, 0), Coarse([PLACE, other], SECOND // 50)
    seen = tracked(view, track)
    true = FakeView([PLACE, other]).depth(seen.box)
    (rival,) = seen.beside
    assert seen.depth is not None and true is not None and rival.depth is not None
    return true, seen.depth, rival.depth


def test_an_estimated_range_is_bettered_by_the_height_of_the_drone() -> None:
    true, found, beside = depths(MISSION)
    assert found.z_m == pytest.approx(true.z_m, rel=0.03)
    assert beside.z_m == pytest.approx(true.z_m, rel=0.06)  # it stands as far away, and on the same ground
    assert abs(found.z_m - true.z_m) < 2.0 * found.sigma_m < 0.1 * true.z_m


@pytest.mark.parametrize("flies", [False, True])
def test_nothing_is_said_where_no_height_is_known_or_the_target_flies(flies: bool) -> None:
    mission = replace(MISSION, target=replace(MISSION.target, flies=True)) if flies else MissionConfig()
    true, found, _ = depths(mission)
    assert found.z_m == pytest.approx(1.2 * true.z_m)


def test_what_the_ground_says_is_off_by_no_more_than_is_stated() -> None:
    """Heights and tilts drawn as they are known: the range is off by as much as it says, from steep to shallow."""
    known, rng = OverGround(0.05, math.radians(1.0)), np.random.default_rng(3)
    for fall_m, ahead_m in ((0.9, 2.4), (1.5, 1.5), (0.7, 2.6)):
        off: list[float] = []
        for _ in range(300):
            tilt = known.tilt_sigma_rad * rng.standard_normal()
            # to the target's middle, level camera turned down by the error alone
            fall = fall_m + known.height_sigma_m * rng.standard_normal()
            c, s = math.cos(tilt), math.sin(tilt)
            R = LEVEL @ np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
            v = 360.0 + 920.0 * fall_m / ahead_m
            T_n_c = Pose(R, np.array([0.0, 0.0, -fall - 0.1]))
            found = known.bettered(Depth(5.0, 1e3), Box(450.0, v - 20.0, 60.0, 40.0), TELLO, T_n_c, -0.1)
            off.append((found.z_m - ahead_m) / found.sigma_m)
        assert 0.8 < float(np.sqrt(np.mean(np.square(off)))) < 1.2


def test_a_ray_that_hardly_comes_down_betters_nothing() -> None:
    depth, box = Depth(3.0, 0.3), Box(450.0, 380.0, 60.0, 40.0)
    assert OverGround(0.04, 0.017).bettered(depth, box, TELLO, Pose(LEVEL, np.array([0.0, 0.0, -1.0])), -0.1) is depth
    from_below = Pose(T_N_C.R, np.array([0.0, 0.0, 0.5]))
    assert OverGround(0.04, 0.017).bettered(depth, box, CAMERA, from_below, -0.1) is depth
