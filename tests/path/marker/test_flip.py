"""The gate over time."""

from __future__ import annotations

import math

import numpy as np

from path import rotation
from path.geometry import Matrix
from path.marker.flip import FlipGate
from path.observations import Missed, MissReason

FLIPPED = Missed(MissReason.MARKER_FLIPPED)
FRAME_NS = 20_000_000


def tilted(degrees: float) -> Matrix:
    return rotation.exp(np.array([math.radians(degrees), 0.0, 0.0]))


def test_a_drone_that_turns_passes():
    gate = FlipGate()
    for k in range(100):
        assert gate.check(tilted(2.0 * k), k * FRAME_NS) is None  # 100 degrees a second


def test_a_frame_turned_over_is_refused_and_the_next_right_one_is_not():
    gate = FlipGate()
    assert gate.check(tilted(0.0), 0) is None
    assert gate.check(tilted(60.0), FRAME_NS) == FLIPPED
    assert gate.check(tilted(3.0), 2 * FRAME_NS) is None


def test_an_attitude_that_stays_replaces_the_old_one():
    gate = FlipGate(settle=5)
    assert gate.check(tilted(0.0), 0) is None
    seen = [gate.check(tilted(60.0), k * FRAME_NS) for k in range(1, 8)]
    assert seen == [FLIPPED] * 5 + [None] * 2


def test_attitudes_that_disagree_with_each_other_replace_nothing():
    gate = FlipGate(settle=5)
    assert gate.check(tilted(0.0), 0) is None
    for k in range(1, 20):
        assert gate.check(tilted(60.0 if k % 2 else -60.0), k * FRAME_NS) == FLIPPED
    assert gate.check(tilted(0.0), 20 * FRAME_NS) is None


def test_after_a_while_unseen_it_may_have_turned():
    gate = FlipGate()
    assert gate.check(tilted(0.0), 0) is None
    assert gate.check(tilted(60.0), 1_000_000_000) is None
