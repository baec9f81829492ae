"""Poses that come late, from common views, among those of the marker."""

from __future__ import annotations

import numpy as np
import pytest

from path.geometry.transforms import Pose
from path.observations import Missed, MissReason
from path.relative_pose.filter import RelativeFilter, RelativeSettings, Source

FRAME_NS = 20_000_000
SECOND_NS = 1_000_000_000
LATE = RelativeSettings(late=True, coast_s=4.0)
R_N_C = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
FACING = R_N_C @ np.diag([1.0, -1.0, -1.0])
SEEN = np.diag(np.array([0.003, 0.003, 0.005, 0.005, 0.005, 0.005]) ** 2)
COMMON = np.diag(np.array([0.03, 0.03, 0.03, 0.012, 0.012, 0.012]) ** 2)


def still(settings: RelativeSettings = LATE) -> RelativeFilter:
    filtered = RelativeFilter(settings)
    for k in range(0, 400, 5):
        filtered.set_own_velocity(k * FRAME_NS, (0.0, 0.0, 0.0))
        filtered.set_peer_velocity(k * FRAME_NS, (0.0, 0.0, 0.0))
    return filtered


def marker(filtered: RelativeFilter, stamp_ns: int, north_m: float) -> Missed | None:
    pose = Pose(R_N_C.T @ FACING, R_N_C.T @ np.array([north_m, 0.0, 0.0]))
    return filtered.update(stamp_ns, pose, SEEN, R_N_C, FACING)


def common(filtered: RelativeFilter, stamp_ns: int, north_m: float) -> Missed | None:
    pose = Pose(R_N_C.T @ FACING, R_N_C.T @ np.array([north_m, 0.0, 0.0]))
    return filtered.update(stamp_ns, pose, COMMON, R_N_C, FACING, Source.COMMON_VIEW)


def test_a_pose_that_comes_late_counts_as_one_that_came_in_time() -> None:
    in_time = still()
    late = still()
    for k in range(60):
        marker(late, k * FRAME_NS, 1.0)
    for k in range(60):
        if k == 20:
            common(in_time, 20 * FRAME_NS - 1, 1.02)
        marker(in_time, k * FRAME_NS, 1.0)
    assert common(late, 20 * FRAME_NS - 1, 1.02) is None
    one = in_time.predict(2 * SECOND_NS)
    other = late.predict(2 * SECOND_NS)
    assert one is not None
    assert other is not None
    assert other.marker_n_m == pytest.approx(one.marker_n_m, abs=1e-12)
    np.testing.assert_allclose(other.covariance, one.covariance)
    assert late.source is Source.MARKER


def test_common_views_carry_the_pose_while_no_marker_is_seen_and_it_is_said() -> None:
    filtered = still()
    for k in range(50):
        marker(filtered, k * FRAME_NS, 1.0)
    assert filtered.source is Source.MARKER
    for second in range(2, 6):
        assert common(filtered, second * SECOND_NS, 1.02) is None
        assert filtered.source is Source.COMMON_VIEW
    seen = filtered.predict(6 * SECOND_NS)
    assert seen is not None
    assert seen.marker_n_m[0] == pytest.approx(1.02, abs=0.02)
    assert 0.02 < seen.sigma_m < 0.12
    assert marker(filtered, 6 * SECOND_NS, 1.01) is None
    assert filtered.source is Source.MARKER


def test_one_that_is_older_than_all_that_is_remembered_is_stale() -> None:
    filtered = still()
    marker(filtered, SECOND_NS, 1.0)
    assert common(filtered, SECOND_NS - 1, 1.0) == Missed(MissReason.STALE, ignored=True)
    usual = still(RelativeSettings())
    marker(usual, 1, 1.0)
    marker(usual, SECOND_NS // 2, 1.0)
    assert common(usual, SECOND_NS // 4, 1.0) == Missed(MissReason.STALE, ignored=True)


def test_three_common_views_that_agree_replace_a_pose_that_they_contradict() -> None:
    filtered = still()
    common(filtered, SECOND_NS, 1.0)
    refused = Missed(MissReason.POSE_UNCERTAIN)
    times = [SECOND_NS + k * SECOND_NS // 2 for k in (1, 2, 3)]
    told = [common(filtered, stamp_ns, 3.5) for stamp_ns in times]
    assert told == [refused, refused, None]
    seen = filtered.predict(times[-1])
    assert seen is not None
    assert seen.marker_n_m[0] == pytest.approx(3.5, abs=0.05)


def test_a_marker_and_a_common_view_of_one_frame_both_count() -> None:
    filtered = still()
    for k in range(30):
        assert marker(filtered, k * FRAME_NS, 1.0) is None
    assert common(filtered, 20 * FRAME_NS, 1.0) is None
    assert filtered.source is Source.MARKER
