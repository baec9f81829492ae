from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.link.units import (
    OutOfRange,
    box_from,
    box_to,
    direction_from,
    direction_to,
    point_from,
    point_to,
    rotation_from,
    rotation_to,
)
from path.messages import Quat, Vec3
from path.observations import Box

HALF_PART_M = 0.5 / 256 / 1000.0
coordinate = st.floats(-32.7, 32.7)


def turn_deg(a: Quat, b: Quat) -> float:
    """Angle of the rotation between two unit quaternions."""
    (aw, ax, ay, az), (bw, bx, by, bz) = a, b
    sine = math.hypot(
        aw * bx - ax * bw - ay * bz + az * by,
        aw * by + ax * bz - ay * bw - az * bx,
        aw * bz - ax * by + ay * bx - az * bw,
    )
    return math.degrees(2.0 * math.atan2(sine, abs(aw * bw + ax * bx + ay * by + az * bz)))


def between_deg(a: Vec3, b: Vec3) -> float:
    return math.degrees(math.atan2(float(np.linalg.norm(np.cross(a, b))), float(np.dot(a, b))))


@given(point=st.tuples(coordinate, coordinate, coordinate))
def test_a_point_moves_by_half_a_part_at_most(point: Vec3) -> None:
    back = point_from(*point_to("point", point))
    assert max(abs(a - b) for a, b in zip(back, point, strict=True)) <= HALF_PART_M * (1.0 + 1e-9)


def test_the_parts_of_a_negative_coordinate_count_upward() -> None:
    assert point_to("point", (-0.0005, 0.0015, -1.0)) == ((-1, 1, -1000), (128, 128, 0))


def test_a_rotation_turns_by_less_than_the_stated_error() -> None:
    rng = np.random.default_rng(2)
    errors: list[float] = []
    for q in rng.standard_normal((20_000, 4)):
        w, x, y, z = (q / np.linalg.norm(q)).tolist()
        errors.append(turn_deg((w, x, y, z), rotation_from("q", rotation_to("q", (w, x, y, z)))))
    assert max(errors) < 0.0048
    assert math.sqrt(float(np.mean(np.square(errors)))) < 0.0025


@pytest.mark.parametrize(
    "q",
    [
        (1.0, 0.0, 0.0, 0.0),
        (-1.0, 0.0, 0.0, 0.0),
        (0.0, 1.0, 0.0, 0.0),
        (0.0, 0.0, -1.0, 0.0),
        (0.0, 0.6, 0.0, 0.8),
        (1e-9, 0.0, 0.6, 0.8),
        (-1e-9, 0.0, 0.6, 0.8),
        (1.0, 1e-12, 0.0, 0.0),
        (1.0004, 0.0, 0.0, 0.0),
    ],
)
def test_rotations_at_the_ends_of_the_range(q: Quat) -> None:
    back = rotation_from("q", rotation_to("q", q))
    assert turn_deg(q, back) < 0.0048
    assert math.hypot(*back) == pytest.approx(1.0, abs=1e-12)
    assert back[0] >= -2e-4  # rounding may lengthen a half turn a little


def test_a_direction_turns_by_less_than_the_stated_error() -> None:
    rng = np.random.default_rng(3)
    worst = 0.0
    for v in rng.standard_normal((20_000, 3)):
        x, y, z = (v / np.linalg.norm(v)).tolist()
        back = direction_from(*direction_to("g", (x, y, z)))
        worst = max(worst, between_deg((x, y, z), back))
        assert abs(math.hypot(*back) - 1.0) < 1e-12
    assert worst < 0.0037


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("axis", range(3))
def test_directions_along_the_axes_are_exact(axis: int, sign: float) -> None:
    direction = [0.0, 0.0, 0.0]
    direction[axis] = sign
    g = (direction[0], direction[1], direction[2])
    assert direction_from(*direction_to("g", g)) == pytest.approx(g, abs=1e-12)


@given(first=st.integers(-32768, 32767), second=st.integers(-32768, 32767))
def test_every_pair_of_numbers_is_a_direction(first: int, second: int) -> None:
    assert math.hypot(*direction_from(first, second)) == pytest.approx(1.0, abs=1e-12)


def test_every_coordinate_that_the_wire_can_say_can_be_said_again() -> None:
    for mm, part in ((-32768, 0), (-32768, 152), (32767, 255), (0, 0), (-1, 255)):
        point = point_from((mm, 0, 0), (part, 0, 0))
        assert point_to("point", point) == ((mm, 0, 0), (part, 0, 0))
    with pytest.raises(OutOfRange, match="point"):
        point_to("point", (-32.769, 0.0, 0.0))


def test_no_box_is_four_zeros() -> None:
    assert box_to(None) == (0, 0, 0, 0)


@pytest.mark.parametrize(("width", "height"), [(3840, 2160), (7680, 4320)])
def test_a_box_anywhere_in_the_largest_image_can_be_said(width: int, height: int) -> None:
    for x, y in ((-0.5, -0.5), (width - 10.0, height - 10.0)):
        assert box_from(*box_to(Box(x, y, 10.0, 10.0))) == Box(x, y, 10.0, 10.0)


def test_the_narrowest_box_is_one_step_wide_and_one_high_and_anything_less_is_none() -> None:
    step = 1.0 / 4.0
    assert box_to(Box(0.0, 0.0, step, step)) == (0, 0, 1, 1)
    assert box_to(Box(0.0, 0.0, 65535 * step, 65535 * step)) == (0, 0, 65535, 65535)
    for box in (Box(0.0, 0.0, 0.4 * step, 1.0), Box(0.0, 0.0, 1.0, 0.4 * step)):
        with pytest.raises(OutOfRange, match=r"box\.[wh]"):
            box_to(box)


def test_a_turn_may_be_as_long_as_rounding_makes_a_half_turn_and_no_longer() -> None:
    assert rotation_from("q", (-32768, 0, 0)) == pytest.approx((0.0, -1.0, 0.0, 0.0), abs=1e-4)
    with pytest.raises(OutOfRange, match="half turn"):
        rotation_from("q", (-32768, 1, 0))
