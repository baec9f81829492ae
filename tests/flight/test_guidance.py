from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.interfaces import FlightMode, VehicleState, VelocitySetpoint
from flight.guidance import (
    Anchor,
    Vec3,
    add,
    bearing,
    close_in,
    from_heading,
    limit,
    norm,
    scale,
    slew,
    spare_accel,
    subtract,
    way_until_away,
)

numbers = st.floats(-50.0, 50.0)
vectors = st.tuples(numbers, numbers, numbers)
angles = st.floats(-math.pi, math.pi)
positive = st.floats(0.01, 5.0)


def at(position: Vec3) -> VehicleState:
    return VehicleState(
        0,
        0,
        position,
        (0.0, 0.0, 0.0),
        (1.0, 0.0, 0.0, 0.0),
        True,
        True,
        True,
        FlightMode.OFFBOARD,
        1.0,
    )


@given(vectors, st.floats(0.0, 5.0))
def test_limit_never_exceeds_the_length_and_keeps_the_direction(a: Vec3, longest: float) -> None:
    limited = limit(a, longest)
    assert norm(limited) <= longest * (1 + 1e-9)
    assert norm(limited) == pytest.approx(min(norm(a), longest), abs=1e-9)
    # along a: nothing is left of it across a
    assert norm(subtract(scale(limited, norm(a)), scale(a, norm(limited)))) < 1e-6


@given(vectors, angles)
def test_a_heading_turns_forward_and_right_and_leaves_down(offset: Vec3, heading: float) -> None:
    turned = from_heading(offset, heading)
    assert norm(turned) == pytest.approx(norm(offset), abs=1e-9)
    assert turned[2] == offset[2]
    assert from_heading(turned, -heading) == pytest.approx(offset, abs=1e-9)


@given(vectors, angles, st.floats(0.0, 60.0))
def test_the_way_out_of_reach_is_no_longer_than_it_must_be(
    offset: Vec3, heading: float, distance_m: float
) -> None:
    along = from_heading((1.0, 0.0, 0.0), heading)
    way_m = way_until_away(offset, along, distance_m)
    north, east, _ = add(offset, scale(along, way_m))
    assert way_m >= 0.0
    already_m = math.hypot(offset[0], offset[1])
    assert math.hypot(north, east) == pytest.approx(max(distance_m, already_m), abs=1e-6)


@pytest.mark.parametrize(
    ("heading_deg", "forward", "right"),
    [
        (0.0, (1.0, 0.0), (0.0, 1.0)),
        (90.0, (0.0, 1.0), (-1.0, 0.0)),
        (180.0, (-1.0, 0.0), (0.0, -1.0)),
    ],
)
def test_right_is_clockwise_of_forward(
    heading_deg: float, forward: tuple[float, float], right: tuple[float, float]
) -> None:
    heading = math.radians(heading_deg)
    assert from_heading((1.0, 0.0, 0.0), heading)[:2] == pytest.approx(forward, abs=1e-12)
    assert from_heading((0.0, 1.0, 0.0), heading)[:2] == pytest.approx(right, abs=1e-12)


@given(angles, positive, numbers)
def test_a_bearing_is_the_heading_whose_forward_is_the_vector(
    heading: float, length: float, down: float
) -> None:
    yaw = bearing(from_heading((length, 0.0, down), heading))
    assert math.remainder(yaw - heading, 2 * math.pi) == pytest.approx(0.0, abs=1e-9)


@given(vectors, vectors, positive, positive)
def test_only_the_correction_is_limited_not_the_feed_forward(
    error: Vec3, feed_forward: Vec3, gain: float, fastest: float
) -> None:
    correction = subtract(close_in(error, feed_forward, gain, fastest), feed_forward)
    assert norm(correction) == pytest.approx(min(gain * norm(error), fastest), abs=1e-6)
    assert sum(c * e for c, e in zip(correction, error, strict=True)) >= -1e-6


def test_an_anchor_is_reached_and_then_held() -> None:
    anchor = Anchor((3.0, -2.0, -1.5), 0.7)
    position: Vec3 = (0.0, 0.0, 0.0)
    speeds: list[float] = []
    for _ in range(400):
        setpoint = anchor.hold(at(position))
        assert setpoint.yaw_rad == 0.7
        speeds.append(norm(setpoint.velocity_n_mps))
        position = add(position, scale(setpoint.velocity_n_mps, 0.04))
    assert position == pytest.approx(anchor.position_n_m, abs=1e-3)
    assert max(speeds) == pytest.approx(0.8)  # far away: at the limit, never above


@given(vectors, vectors, st.floats(0.001, 0.2), st.floats(0.1, 3.0))
def test_slew_limits_the_acceleration_and_gets_there(
    before: Vec3, wanted: Vec3, dt_s: float, max_accel: float
) -> None:
    previous, goal = VelocitySetpoint(before, 0.0), VelocitySetpoint(wanted, 1.25)
    after = slew(previous, goal, dt_s, max_accel)
    change = norm(subtract(after.velocity_n_mps, before))
    assert change <= max_accel * dt_s * (1 + 1e-6) + 1e-12
    assert after.yaw_rad == 1.25
    left = norm(subtract(wanted, after.velocity_n_mps))
    assert left == pytest.approx(norm(subtract(wanted, before)) - change, abs=1e-6)
    if norm(subtract(wanted, before)) <= max_accel * dt_s:
        assert after.velocity_n_mps == pytest.approx(wanted, abs=1e-12)


def test_what_it_comes_to_may_brake_with_all_that_it_has_and_is_not_slid_over() -> None:
    """At 1.5 m/s a target that brakes with 1.5 m/s2 takes a drone's 1.6 m/s2; one that stands takes
    nothing.
    """
    assert spare_accel(1.6, 0.0, 1.5, 1.0) == pytest.approx(1.6)
    assert spare_accel(1.6, 0.3, 1.5, 1.0) == pytest.approx(1.3)
    assert spare_accel(1.6, 1.5, 1.5, 1.0) == pytest.approx(0.2 * 1.6)
    assert spare_accel(3.0, 9.0, 1.5, 1.0) == pytest.approx(1.5)
