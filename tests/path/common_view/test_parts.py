"""Keyframes cut into parts for a link, and put together again."""

from __future__ import annotations

import random
from dataclasses import replace

import numpy as np
import pytest

from path.common_view.estimate import CommonView, common_view
from path.common_view.keyframe import Keyframe
from path.common_view.parts import Gathered, KeyframeSource, part_count, parts_of
from path.common_view.read import SENT
from path.messages import PART_BYTES, KeyframePart
from tests.path.common_view.drawn import (
    DEPTH_SIGMA,
    GRAVITY_SIGMA,
    LENS,
    Look,
    around,
    looks,
    room,
)

SOURCE = KeyframeSource(LENS, SENT, DEPTH_SIGMA, GRAVITY_SIGMA)
NEWER_NS = 2_000_000_000


@pytest.fixture(scope="module")
def seen() -> Look:
    return looks(room(1), around(0.0), around(30.0), 0)


def parts(keyframe: Keyframe, capture_ns: int = 1_000_000_000) -> list[KeyframePart]:
    return parts_of(keyframe, LENS, capture_ns)


def gathered(of: list[KeyframePart]) -> Gathered:
    found = Gathered(SOURCE)
    for part in of:
        assert found.add(part)
    return found


def test_a_keyframe_comes_back_to_a_millimetre_and_an_eighth_of_a_pixel(seen: Look) -> None:
    sent = parts(seen.first)
    assert len(sent) == part_count(len(seen.first.points_c), SENT)
    assert {len(part.data) for part in sent} == {PART_BYTES}
    back = gathered(sent)
    assert back.complete
    found = back.keyframe()
    np.testing.assert_array_equal(found.descriptors, seen.first.descriptors)
    np.testing.assert_allclose(found.points_c, seen.first.points_c, atol=0.0015)
    np.testing.assert_allclose(found.grid.depth, seen.first.grid.depth, atol=0.00051)
    np.testing.assert_allclose(found.grid.lens, seen.first.grid.lens)
    np.testing.assert_allclose(found.R_l_c, seen.first.R_l_c, atol=1e-12)


def test_what_is_lost_on_the_way_is_left_out_and_the_pose_is_found_all_the_same(
    seen: Look,
) -> None:
    sent = parts(seen.first)
    came = [part for part in sent if part.number % 4]
    random.Random(3).shuffle(came)
    back = gathered(came)
    assert back.usable
    assert not back.complete
    found = back.keyframe()
    assert 0.4 * len(seen.first.points_c) < len(found.points_c) < 0.7 * len(seen.first.points_c)
    known = found.grid.depth > 0.0
    assert 0.6 * known.size < np.count_nonzero(known) < 0.8 * known.size
    np.testing.assert_allclose(found.grid.depth[known], seen.first.grid.depth[known], atol=0.00051)
    pose = common_view(found, seen.second, seen.prior)
    assert isinstance(pose, CommonView)
    assert np.linalg.norm(seen.off(pose.yaw_rad, pose.t_m)[:3]) < 0.1


def test_parts_that_come_twice_or_of_an_older_keyframe_or_of_none_are_dropped(seen: Look) -> None:
    older = parts(seen.first)
    newer = parts(seen.first, NEWER_NS)
    back = gathered(older[:3])
    assert not back.add(older[1])
    assert not back.add(replace(older[0], number=255))
    assert not back.usable
    assert back.begins(newer[0])
    assert back.add(newer[0])
    assert not back.add(older[5])
    assert back.capture_ns == NEWER_NS
    for part in newer[1:]:
        assert not back.complete
        back.add(part)
    assert back.complete


def test_a_keyframe_without_corners_is_depth_alone(seen: Look) -> None:
    bare = replace(seen.first, points_c=np.zeros((0, 3)), descriptors=np.zeros((0, 32), np.uint8))
    found = gathered(parts(bare)).keyframe()
    assert len(found.points_c) == 0
    np.testing.assert_allclose(found.grid.depth, seen.first.grid.depth, atol=0.00051)


def test_a_keyframe_has_no_more_parts_than_its_numbers_tell(seen: Look) -> None:
    assert len(seen.first.points_c) <= SENT.points <= 255
    assert part_count(SENT.points, SENT) <= 256
