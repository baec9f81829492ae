"""A number says what it may be, and a refusal what it probably was meant to be."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import pytest

from path.bounds import Bounds, check_bounds, refusal


@dataclass(frozen=True)
class Course:
    side_m: Annotated[float, Bounds(0.005, 2.0)] = 0.04
    frames: Annotated[int, Bounds(1, 1000, "frames")] = 350
    share: Annotated[float, Bounds(0.0, 1.0, "of 1", above=True)] = 0.5
    name: str = ""


@pytest.mark.parametrize(
    ("name", "value", "bounds", "said"),
    [
        ("side_m", 40.0, Bounds(0.005, 2.0), "40.0 m is not within 0.005..2 m: millimetres?"),
        ("side_m", 150.0, Bounds(0.005, 2.0), "150.0 m is not within 0.005..2 m: millimetres?"),
        ("height_m", 150.0, Bounds(0.3, 100.0), "150.0 m is not within 0.3..100 m: centimetres?"),
        ("height_m", -1.5, Bounds(0.3, 100.0), "-1.5 m is not within 0.3..100 m: a sign too many?"),
        ("height_m", 1e9, Bounds(0.3, 100.0), "1000000000.0 m is not within 0.3..100 m"),
        (
            "pitch_down_deg",
            405.0,
            Bounds(-90.0, 90.0),
            "405.0 deg is not within -90..90 deg: more than a whole turn?",
        ),
        ("pitch_down_deg", 120.0, Bounds(-90.0, 90.0), "120.0 deg is not within -90..90 deg"),
        ("speed_mps", 36.0, Bounds(0.1, 15.0), "36.0 m/s is not within 0.1..15 m/s: km/h?"),
        (
            "battery",
            20.0,
            Bounds(0.0, 0.9, "of 1"),
            "20.0 of 1 is not within 0..0.9 of 1: per cent?",
        ),
        ("hold_s", 7000.0, Bounds(0.0, 600.0), "7000.0 s is not within 0..600 s: milliseconds?"),
        (
            "rate",
            0.0,
            Bounds(0.0, 1.0, "of 1", above=True),
            "0.0 of 1 is not above 0 and at most 1 of 1",
        ),
    ],
)
def test_a_refusal_names_value_unit_range_and_the_likely_mistake(
    name: str, value: float, bounds: Bounds, said: str
) -> None:
    assert refusal(name, value, bounds) == said


@pytest.mark.parametrize(
    ("field", "value"),
    [("side_m", 40.0), ("side_m", math.nan), ("side_m", math.inf), ("side_m", True), ("side_m", "0.04"),
     ("frames", 0), ("frames", 350.0), ("frames", True), ("frames", 10**20), ("share", 0.0), ("share", -1.0)],
)  # fmt: skip
def test_what_is_made_in_code_is_held_to_the_same_bounds(field: str, value: object) -> None:
    with pytest.raises(ValueError, match=f"^{field}: "):
        check_bounds(Course(**{field: value}))  # type: ignore[arg-type]


def test_what_is_within_passes() -> None:
    check_bounds(Course())
    check_bounds(Course(2.0, 1000, 1.0))
    check_bounds(Course(side_m=1))
