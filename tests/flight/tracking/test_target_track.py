"""The filter of the object that is followed, against its equations, and every bound that it sets."""

from __future__ import annotations

import math

import numpy as np
import pytest

from flight.config import FollowConfig, MissionConfig, TargetDesignation
from flight.guidance import Vec3
from flight.tracking.target_track import TargetTrack
from path.belief.motion import Motion

S = 1_000_000_000
RANGE_M = 2.0
ACCEL = 0.5
HERE: Vec3 = (3.0, -1.0, -0.4)


def track(*, flies: bool = False, carry_s: float = 0.0) -> TargetTrack:
    return TargetTrack(HERE, 5 * S, ACCEL, range_m=RANGE_M, flies=flies, carry_s=carry_s)


def variance_m2(of: TargetTrack, after_s: float = 0.0) -> float:
    return of.predict(of.stamp_ns + round(after_s * S))[1] ** 2


class Kalman:
    """One axis of a constant-velocity filter that is driven by acceleration, as in the books."""

    def __init__(self) -> None:
        self.mean = np.zeros(2)
        self.known = np.diag([(0.145 * RANGE_M) ** 2, (0.24 * RANGE_M) ** 2])

    def ahead(self, dt: float) -> tuple[np.ndarray, np.ndarray]:
        F = np.array([[1.0, dt], [0.0, 1.0]])
        push = np.array([0.5 * dt * dt, dt])
        return F @ self.mean, F @ self.known @ F.T + ACCEL**2 * np.outer(push, push)

    def fuse(self, measured: float, dt: float, sigma: float, moves: bool) -> None:
        mean, P = self.ahead(dt)
        gain = P[:, 0] / (P[0, 0] + sigma**2)
        if not moves:
            gain[1] = 0.0
        self.mean = mean + gain * (measured - mean[0])
        kept = P - np.outer(gain, P[0])
        self.known = np.array([[kept[0, 0], kept[0, 1]], [kept[0, 1], kept[1, 1]]])


def test_place_velocity_and_what_is_known_of_them_are_those_of_a_kalman_filter() -> None:
    own = track()
    axes = [Kalman() for _ in range(2)]
    stamp_ns = own.stamp_ns
    rng = np.random.default_rng(3)
    for k, dt in enumerate((0.02, 0.5, 0.0, 0.3, 0.02, 1.0)):
        stamp_ns += round(dt * S)
        off = rng.normal(0.0, 0.2, 2).tolist()
        measured = (HERE[0] + off[0], HERE[1] + off[1], HERE[2])
        cut = k in (1, 4)
        own.update(measured, stamp_ns, cut=cut)
        sigma = RANGE_M * (0.072 if cut else 0.024)
        for axis, each in enumerate(axes):
            each.fuse(off[axis], dt, sigma, moves=not cut)
            assert own.position_n_m[axis] - HERE[axis] == pytest.approx(each.mean[0])
            assert own.velocity_n_mps[axis] == pytest.approx(each.mean[1])
        for after_s in (0.0, 0.4, 1.5):
            mean, P = axes[0].ahead(after_s)
            place, sigma_m = own.predict(stamp_ns + round(after_s * S))
            assert place[0] - HERE[0] == pytest.approx(mean[0])
            assert sigma_m == pytest.approx(math.sqrt(P[0, 0]))
    assert own.stamp_ns == own.seen_ns == stamp_ns


def test_the_past_is_predicted_as_the_newest_that_is_known() -> None:
    own = track()
    assert own.predict(own.stamp_ns - S) == own.predict(own.stamp_ns)


def test_a_measurement_of_the_past_is_ignored_and_one_of_the_same_instant_is_not() -> None:
    own = track()
    own.update((4.0, 0.0, 0.0), own.stamp_ns - 1)
    assert own.position_n_m == HERE
    own.update((4.0, -1.0, -0.4), own.stamp_ns)
    assert own.position_n_m[0] == pytest.approx(4.0, abs=0.05)


@pytest.mark.parametrize("flies", [False, True])
def test_only_what_flies_climbs(flies: bool) -> None:
    own = track(flies=flies)
    for k in range(1, 60):
        own.update((3.0, -1.0, -0.4 - 0.01 * k), own.stamp_ns + S // 50)
    assert own.velocity_n_mps[2] == (pytest.approx(-0.5, abs=0.1) if flies else 0.0)
    motion = Motion(np.array([1.0, 2.0, -3.0, 0.1, 0.2, 0.3]), np.eye(6), 9 * S)
    height_m = own.position_n_m[2]
    own.found_again(motion)
    assert own.position_n_m == (1.0, 2.0, -3.0 if flies else height_m)
    assert own.velocity_n_mps == (0.1, 0.2, 0.3 if flies else 0.0)


def test_a_track_that_is_found_again_knows_what_the_belief_knows() -> None:
    own = track()
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = np.diag([0.01, 0.02, 0.03])
    covariance[3:, 3:] = np.diag([0.3, 0.5, 0.7])
    covariance[:3, 3:] = covariance[3:, :3] = np.diag([0.001, 0.002, 0.006])
    own.found_again(Motion(np.zeros(6), covariance, 9 * S))
    assert own.stamp_ns == 9 * S
    assert variance_m2(own) == pytest.approx(0.02)
    driven = 0.25 * ACCEL**2
    assert variance_m2(own, 1.0) == pytest.approx(0.02 + 2.0 * 0.003 + 0.5 + driven)


def test_depth_alone_moves_a_track_along_the_ground_and_is_no_sight_of_it() -> None:
    own = track()
    plain = Kalman()
    own.carry((3.2, -1.0, 7.0), own.stamp_ns + S // 2)
    plain.fuse(0.2, 0.5, 0.072 * RANGE_M, moves=True)
    assert own.position_n_m == pytest.approx((3.0 + plain.mean[0], -1.0, -0.4))
    assert own.velocity_n_mps == pytest.approx((plain.mean[1], 0.0, 0.0))
    assert (own.stamp_ns, own.seen_ns) == (5 * S + S // 2, 5 * S)


# --- what to fly by


def moving(speed_mps: float, sigma_mps: float) -> TargetTrack:
    """A track that goes north-east with a speed, which is known so well."""
    own = track()
    covariance = np.diag([0.0, 0.0, 0.0, *[sigma_mps**2] * 3])
    part = speed_mps / math.sqrt(2.0)
    own.found_again(Motion(np.array([*HERE, part, part, 0.0]), covariance, own.stamp_ns))
    return own


def test_a_velocity_counts_as_far_as_it_is_known() -> None:
    for speed_mps, sigma_mps in ((1.0, 0.5), (0.4, 0.5), (0.0, 0.3)):
        _, velocity = moving(speed_mps, sigma_mps).believed(5 * S)
        share = speed_mps**4 / (speed_mps**4 + sigma_mps**4)
        assert math.hypot(*velocity) == pytest.approx(share * speed_mps)


def test_what_is_out_of_sight_is_taken_to_brake_and_to_be_where_that_leaves_it() -> None:
    """The place is the sum of all velocities that were believed on the way."""
    own = moving(0.8, 0.3)
    driven = np.zeros(3)
    steps = 4000
    for k in range(steps):
        driven += np.array(own.believed(5 * S + (2 * k + 1) * 2 * S // (2 * steps))[1]) * 2 / steps
    place, velocity = own.believed(7 * S)
    assert np.subtract(place, HERE) == pytest.approx(driven, abs=1e-6)
    known = 0.8**4 / (0.8**4 + 0.3**4)
    braked = known * 0.8**2 / (0.8**2 + (ACCEL * 2.0) ** 2)
    assert math.hypot(*velocity) == pytest.approx(0.8 * braked)
    assert own.believed(4 * S) == own.believed(5 * S)


def test_it_keeps_out_of_the_way_of_the_fastest_that_it_may_be() -> None:
    own = moving(0.8, 0.3)
    assert own.fastest_mps(5 * S) == pytest.approx(0.8 + 2.0 * 0.3)
    assert own.fastest_mps(8 * S) == pytest.approx(0.8 + 2.0 * math.hypot(0.3, 3.0 * ACCEL))
    assert own.fastest_mps(0) == own.fastest_mps(5 * S)


# --- how far it is looked for


def test_the_gate_is_three_deviations_and_a_floor_within_its_bounds() -> None:
    own = track()
    assert own.gate_m(0.0, 5 * S) == pytest.approx(0.048 * RANGE_M)
    assert own.gate_m(0.05, 5 * S) == pytest.approx(0.15 + 0.048 * RANGE_M)
    assert own.gate_m(9.0, 5 * S) == pytest.approx(0.22 * RANGE_M)


def test_the_gate_ends_before_another_object_for_as_long_as_that_is_known() -> None:
    own = track()
    own.note_rival(0.5, 5 * S)
    assert own.gate_m(9.0, 5 * S) == pytest.approx(0.2)
    assert own.gate_m(9.0, 8 * S) == pytest.approx(0.2)
    assert own.gate_m(9.0, 8 * S + 1) == pytest.approx(0.44)
    own.note_rival(0.01, 8 * S)
    assert own.gate_m(9.0, 8 * S) == pytest.approx(0.024 * RANGE_M)


def test_the_nearest_of_others_is_remembered_and_a_farther_one_once_that_is_forgotten() -> None:
    own = track()
    own.note_rival(0.5, 5 * S)
    own.note_rival(0.9, 6 * S)
    assert (own.rival_m, own.rival_ns) == (0.5, 5 * S)
    own.note_rival(0.5, 7 * S)
    assert own.rival_ns == 7 * S
    own.note_rival(0.9, 10 * S)
    assert own.rival_m == 0.5
    own.note_rival(0.9, 10 * S + 1)
    assert (own.rival_m, own.rival_ns) == (0.9, 10 * S + 1)


def test_nobody_was_near_until_somebody_was_and_then_for_three_seconds() -> None:
    own = track()
    assert not own.accompanied(5 * S)
    own.note_company(6 * S)
    assert own.accompanied(9 * S)
    assert not own.accompanied(9 * S + 1)


def test_it_can_have_come_as_far_as_it_can_drive_and_is_looked_for_no_farther_than_it_is_off() -> (
    None
):
    own = track()
    plain = Kalman()
    for after_s in (0.0, 0.3):
        F = np.array([1.0, after_s])
        sigma_m = math.sqrt(F @ plain.known @ F)
        driven_m = 0.5 * ACCEL * after_s**2
        expected_m = 0.048 * RANGE_M + 3.0 * sigma_m + driven_m
        assert own.reach_m(5 * S + round(after_s * S)) == pytest.approx(expected_m)
    assert own.reach_m(99 * S) == pytest.approx(0.96 * RANGE_M)
    assert own.reach_m(0) == own.reach_m(5 * S)
    own.update(HERE, 6 * S)  # place and velocity are known together then
    sigma_m = math.sqrt(variance_m2(own, 0.2) - (0.5 * ACCEL * 0.2**2) ** 2)
    expected_m = 0.048 * RANGE_M + 3.0 * sigma_m + 0.5 * ACCEL * 0.2**2
    assert own.reach_m(6 * S + S // 5) == pytest.approx(expected_m)


# --- its box


def test_depth_may_carry_what_stands_on_the_ground_and_was_seen_whole_not_long_ago() -> None:
    own = track(carry_s=2.0)
    assert not own.carriable(5 * S)
    own.note_size((0.3, 0.4), 6 * S)
    assert (own.size_m, own.whole_ns) == ((0.3, 0.4), 6 * S)
    assert own.carriable(7 * S)
    assert not own.carriable(7 * S + 1)
    own.carry(HERE, 7 * S)  # which is no sight of it
    assert not own.carriable(7 * S + 1)
    above = track(carry_s=2.0, flies=True)
    above.note_size((0.3, 0.4), 5 * S)
    assert not above.carriable(5 * S)


@pytest.mark.parametrize(("noise", "factor"), [(0.0, math.exp(4.0 * 0.08)), (0.06, math.exp(0.4))])
def test_a_box_that_has_suddenly_grown_by_four_deviations_has_more_in_it(
    noise: float, factor: float
) -> None:
    for times, more in ((0.999 * factor, False), (1.001 * factor, True)):
        own = track()
        for k in range(100):
            assert not own.outgrown((0.3, 0.4), noise, (5 + k // 10) * S + k % 10 * S // 10)
        assert own.usual_m == pytest.approx((0.3, 0.4))
        assert own.outgrown((0.3, times * 0.4), noise, 15 * S) is more


@pytest.mark.parametrize("flies", [False, True])
def test_a_mission_s_target_is_followed_as_the_mission_says(flies: bool) -> None:
    follow = FollowConfig(behind_m=3.0, height_m=4.0, target_accel_mps2=1.5, carry_s=1.0)
    mission = MissionConfig(follow=follow, target=TargetDesignation(flies=flies))
    own = TargetTrack.of(mission, HERE, 5 * S)
    assert own.range_m == 5.0
    assert own.identity is not None
    assert variance_m2(own) == pytest.approx((0.145 * 5.0) ** 2)
    later = (0.145 * 5.0) ** 2 + (0.24 * 5.0) ** 2 + (0.5 * 1.5) ** 2
    assert variance_m2(own, 1.0) == pytest.approx(later)
    own.note_size((0.3, 0.4), 5 * S)
    assert own.carriable(6 * S) is not flies


def test_nothing_else_is_known_of_a_track_that_begins() -> None:
    own = TargetTrack(HERE, 5 * S)
    usual_m = math.hypot(FollowConfig().behind_m, FollowConfig().height_m)
    assert own.range_m == usual_m
    assert (own.stamp_ns, own.seen_ns, own.whole_ns) == (5 * S, 5 * S, 5 * S)
    assert (own.velocity_n_mps, own.size_m, own.usual_m) == ((0.0, 0.0, 0.0), None, None)
    assert own.gate_m(9.0, 5 * S) == pytest.approx(0.22 * usual_m)
    driven = (0.24 * usual_m) ** 2 + (0.5 * 0.6) ** 2
    assert variance_m2(own, 1.0) == pytest.approx((0.145 * usual_m) ** 2 + driven)
