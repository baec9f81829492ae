"""The size of a box in metres against the target's: a body that turns stays within it, two in one
box do not.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from path.camera.model import CameraModel
from path.config import EvidenceConfig, MethodConfig
from path.gate.agreement import TwoViews
from path.gate.evidence import EvidenceGate
from path.gate.window import AgreementWindow, FramePair, Offsets
from path.geometry.rigid import rigid
from path.geometry.transforms import Pose
from path.messages import Vec3
from path.observations import Box, Depth, MissReason
from path.target.size import LEARNED_S, Sizes
from tests.path.gate.compared import compared, own_values

MS = 1_000_000
CAMERA = CameraModel(1280, 720, 900.0, 900.0, 639.5, 359.5, (0.0, 0.0, 0.0, 0.0, 0.0))
DOWN: Vec3 = (0.0, 0.0, 1.0)
SPAN_M, HEIGHT_M = 0.39, 0.16
DEPTH = Depth(1.9, 0.02)
CAR_M = np.array([0.32, 0.22, 0.16])
STATED = MethodConfig(gate="evidence", evidence=EvidenceConfig(span_m=SPAN_M, height_m=HEIGHT_M))
UNKNOWN = MethodConfig(gate="evidence")
MOST = STATED.evidence.size_sigmas


def looking(elevation_deg: float, distance_m: float) -> Pose:
    """``T_v_c`` of a camera that looks at the origin from above: ``v`` has z down, the image's x is
    level.
    """
    down, level = math.sin(math.radians(elevation_deg)), math.cos(math.radians(elevation_deg))
    ahead = np.array([level, 0.0, down])
    right = np.array([0.0, 1.0, 0.0])
    R = np.column_stack((right, np.cross(ahead, right), ahead))
    return Pose(R, -distance_m * ahead)


def corners(place_m: tuple[float, float], heading_rad: float) -> np.ndarray:
    """(8, 3) of a car around the origin's height, in ``v``."""
    c, s = math.cos(heading_rad), math.sin(heading_rad)
    signs = np.array(list(product((-0.5, 0.5), repeat=3)))
    return (signs * CAR_M) @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + (
        *place_m,
        0.0,
    )


def box_of(T_v_c: Pose, *bodies: np.ndarray) -> Box:
    pixels = [
        CAMERA.project_point(tuple(p))
        for p in T_v_c.inverse().apply(np.concatenate(bodies)).tolist()
    ]  # type: ignore[arg-type]
    (left, top), (right, bottom) = np.min(pixels, axis=0).tolist(), np.max(pixels, axis=0).tolist()
    return Box(left, top, right - left, bottom - top)


def sizes(T_v_c: Pose, config: MethodConfig) -> Sizes:
    return Sizes(TwoViews(CAMERA, CAMERA, rigid(T_v_c)), config)


def above(T_v_c: Pose, box: Box, config: MethodConfig = STATED) -> float:
    """Of D1's first box: nothing to compare it with but what is stated."""
    z_m = float(np.linalg.norm(T_v_c.t))
    return sizes(T_v_c, config).own(0, box, Depth(z_m, 0.02), (0.0, 0.0, 0.0), DOWN)


@pytest.mark.parametrize(("elevation_deg", "distance_m"), [(30.0, 3.0), (45.0, 1.9), (60.0, 2.5)])
def test_a_car_fits_whichever_way_it_heads(elevation_deg: float, distance_m: float) -> None:
    T_v_c = looking(elevation_deg, distance_m)
    for heading in np.linspace(0.0, math.pi, 37).tolist():
        assert above(T_v_c, box_of(T_v_c, corners((0.0, 0.0), heading))) < 1.0


@pytest.mark.parametrize(("elevation_deg", "distance_m"), [(35.0, 2.9), (45.0, 1.9)])
def test_two_cars_in_one_box_do_not(elevation_deg: float, distance_m: float) -> None:
    """0.32 m apart, which is as near as two of them can be in any direction; all headings and
    directions.
    """
    T_v_c = looking(elevation_deg, distance_m)
    for way, first, second in product(*(np.linspace(0.0, math.pi, 7).tolist(),) * 3):
        aside = 0.16 * math.cos(way), 0.16 * math.sin(way)
        two = corners(aside, first), corners((-aside[0], -aside[1]), second)
        assert above(T_v_c, box_of(T_v_c, *two)) > MOST
        assert above(T_v_c, box_of(T_v_c, *two), UNKNOWN) == 0.0


def test_what_hides_a_part_of_the_target_makes_no_box_too_large() -> None:
    T_v_c = looking(45.0, 1.9)
    whole = box_of(T_v_c, corners((0.0, 0.0), 1.0))
    assert above(T_v_c, Box(whole.x, whole.y, 0.2 * whole.w, whole.h)) <= above(T_v_c, whole)


class Frames:
    """Boxes of D1, one every 20 ms, of a target whose size is not known."""

    def __init__(self) -> None:
        self.T_v_c = looking(45.0, 1.9)
        self.sizes = sizes(self.T_v_c, UNKNOWN)
        self.k = 0

    def above(self, *bodies: np.ndarray) -> float:
        self.k += 1
        return self.sizes.own(
            20 * self.k * MS, box_of(self.T_v_c, *bodies), DEPTH, (0.0, 0.0, 0.0), DOWN
        )


def test_a_car_that_turns_by_a_radian_a_second_fits_though_it_becomes_twice_as_wide() -> None:
    frames = Frames()
    assert all(frames.above(corners((0.0, 0.0), 0.02 * k)) < MOST for k in range(400))


def test_two_that_are_taken_for_one_from_some_frame_on_teach_nothing_until_it_has_lasted() -> None:
    frames = Frames()
    one, two = corners((0.0, 0.0), 0.5), corners((0.0, 0.36), 0.0)
    for _ in range(50):
        assert frames.above(one) < MOST
    for _ in range(round(LEARNED_S / 0.02) - 1):
        assert frames.above(one, two) > MOST
    assert frames.above(one) < MOST  # it has not forgotten what the one is like
    for _ in range(round(LEARNED_S / 0.02)):
        assert frames.above(one, two) > MOST
    assert frames.above(one, two) < MOST  # now it is what the target looks like
    for _ in range(round(3 * LEARNED_S / 0.02)):
        frames.above(one)
    assert frames.above(one, two) > MOST


def test_what_comes_into_view_and_grows_is_not_held_up() -> None:
    frames = Frames()
    box = box_of(frames.T_v_c, corners((0.0, 0.0), 0.5))
    half = Box(box.x, box.y, 0.5 * box.w, box.h)
    for k in range(5):
        assert frames.sizes.own(20 * k * MS, half, DEPTH, (0.0, 0.0, 0.0), DOWN) < MOST
    for k in range(5, 100):
        assert frames.sizes.own(20 * k * MS, box, DEPTH, (0.0, 0.0, 0.0), DOWN) < MOST
    two = box_of(frames.T_v_c, corners((0.0, 0.0), 0.5), corners((0.0, 0.36), 0.0))
    assert frames.sizes.own(2000 * MS, two, DEPTH, (0.0, 0.0, 0.0), DOWN) > MOST


def test_what_was_hidden_in_part_for_a_moment_is_not_held_up_when_it_is_whole_again() -> None:
    frames = Frames()
    box = box_of(frames.T_v_c, corners((0.0, 0.0), 0.5))
    part = Box(box.x, box.y, box.w, 0.4 * box.h)
    for k in range(100):
        assert (
            frames.sizes.own(
                20 * k * MS, part if 70 <= k < 80 else box, DEPTH, (0.0, 0.0, 0.0), DOWN
            )
            < MOST
        )


def test_d2s_box_is_judged_at_its_own_range_and_by_its_own_history() -> None:
    T_v_c1, T_v_c2 = looking(45.0, 1.9), looking(30.0, 3.0)
    both, origin = sizes(T_v_c1, UNKNOWN), (0.0, 0.0, 0.0)
    one, two = corners((0.0, 0.0), 0.5), corners((0.0, 0.36), 0.0)
    views, own = (
        TwoViews(CAMERA, CAMERA, rigid(T_v_c1)),
        own_values(box_of(T_v_c1, one), DEPTH.z_m, origin, DOWN),
    )

    def theirs(stamp_ns: int, *bodies: np.ndarray) -> float:
        box2 = box_of(T_v_c2, *bodies)
        return both.theirs(stamp_ns, box2, 0.01, compared(views, T_v_c2, own, box2, UNKNOWN))

    for k in range(30):
        assert both.own(20 * k * MS, box_of(T_v_c1, one), DEPTH, origin, DOWN) < MOST
        assert theirs(20 * k * MS, one) < MOST
    assert theirs(600 * MS, one, two) > MOST
    assert both.own(600 * MS, box_of(T_v_c1, one), DEPTH, origin, DOWN) < MOST


def told(
    gate: EvidenceGate | AgreementWindow, pairs: int, oversize_every: int, first: int = 0
) -> set[MissReason | None]:
    answers = set[MissReason | None]()
    for k in range(first, first + pairs):
        frames = (k, 20 * k * MS), (k + 1, 20 * (k + 1) * MS)
        oversize = MOST + 0.1 if oversize_every and k % oversize_every == 0 else MOST - 0.1
        answers.add(
            gate.agree(FramePair(k, 20 * k * MS, frames, Offsets((0.0, 0.0)), oversize), 0.9, 0.4)
        )
    return answers


def test_pairs_that_are_too_large_are_no_evidence_however_many() -> None:
    gate = EvidenceGate(UNKNOWN)
    assert told(gate, 2000, 1) == {MissReason.AMBIGUOUS_TARGET}
    assert (gate.count, gate.evidence.reached, gate.complete) == (0, 0.0, False)


def test_a_few_of_them_cost_nothing_and_many_the_block() -> None:
    few, many = EvidenceGate(UNKNOWN), EvidenceGate(UNKNOWN)
    told(few, 100, 4)
    told(many, 100, 2)
    told(few, 1, 0, 101)
    told(many, 1, 0, 101)
    assert few.complete
    assert not many.complete


def test_one_that_begins_amid_a_run_takes_the_evidence_away() -> None:
    gate = EvidenceGate(UNKNOWN)
    told(gate, 101, 0)
    assert gate.complete
    told(gate, 1, 1, 101)
    assert not gate.complete  # the newest pair disagrees
    told(gate, 21, 1, 102)
    told(gate, 1, 0, 123)
    assert not gate.complete  # a block did


def test_the_papers_gate_asks_for_no_size() -> None:
    gate = AgreementWindow(replace(UNKNOWN, gate="count"))
    assert told(gate, 400, 1) == {None}
    assert gate.complete
