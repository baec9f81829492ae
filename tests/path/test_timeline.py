"""A track answers between its samples, a little beyond them, and never across what it did not
see.
"""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from path.timeline import Sample, Track

MS = 1_000_000


def track_of(*samples: tuple[int, float | None], length: int = 8) -> Track:
    """Samples of (ms, value)."""
    track = Track(length, max_bracket_s=0.1)
    for frame, (ms, value) in enumerate(samples):
        track.add(Sample(ms * MS, frame, None if value is None else (value, -value)))
    return track


@given(st.integers(0, 60 * MS), st.floats(-5, 5), st.floats(-100, 100))
def test_linear_motion_is_reproduced(instant_ns: int, slope: float, start: float) -> None:
    track = track_of(*((ms, start + slope * ms) for ms in (0, 20, 41, 60)))
    between = track.at(instant_ns)
    assert between is not None
    value = start + slope * instant_ns / MS
    assert between.values == pytest.approx((value, -value), abs=1e-9)
    assert between.before.stamp_ns <= instant_ns <= between.after.stamp_ns


def test_a_sample_that_is_hit_is_both_neighbours() -> None:
    between = track_of((0, 1.0), (20, 2.0)).at(20 * MS)
    assert between is not None
    assert between.before is between.after
    assert between.values == (2.0, -2.0)


def test_outside_the_track_there_is_nothing() -> None:
    track = track_of((10, 1.0), (30, 2.0))
    assert track.at(10 * MS - 1) is None
    assert track.at(30 * MS + 1) is None
    assert Track(4, 0.1).at(0) is None


def test_nothing_is_interpolated_across_a_gap_or_a_frame_without_values() -> None:
    assert track_of((0, 1.0), (101, 2.0)).at(50 * MS) is None
    track = track_of((0, 1.0), (20, None), (40, 2.0), (60, 2.0))
    assert track.at(10 * MS) is None
    assert track.at(20 * MS) is None
    assert track.at(30 * MS) is None
    assert track.at(50 * MS) is not None


def test_oldest_samples_fall_out() -> None:
    track = track_of(*((10 * i, float(i)) for i in range(10)), length=4)
    assert track.at(50 * MS) is None
    assert track.at(60 * MS) is not None
    assert track.find(5) is None
    found = track.find(9)
    assert found is not None
    assert found.stamp_ns == 90 * MS


def test_frames_are_found_by_their_low_16_bits() -> None:
    track = Track(4, 0.1)
    track.add(Sample(0, 65_535, (1.0,)))
    track.add(Sample(1, 65_536, (2.0,)))
    found = track.find(0)
    assert found is not None
    assert found.values == (2.0,)


@pytest.mark.parametrize(
    ("stamp_ns", "frame"), [(20 * MS, 5), (19 * MS, 5), (30 * MS, 1), (30 * MS, 0)]
)
def test_samples_must_come_in_order(stamp_ns: int, frame: int) -> None:
    track = track_of((0, 1.0), (20, 2.0))
    with pytest.raises(ValueError, match="does not come after"):
        track.add(Sample(stamp_ns, frame, (0.0,)))


def test_extrapolation_follows_the_newest_stretch_and_is_limited() -> None:
    track = track_of((0, 9.0), (100, 1.0), (150, 1.5), (200, 2.0))
    assert track.ahead(250 * MS, slope_span_s=0.1, limit_s=0.05) == pytest.approx((2.5, -2.5))
    assert track.ahead(251 * MS, slope_span_s=0.1, limit_s=0.05) is None
    assert track.ahead(199 * MS, slope_span_s=0.1, limit_s=0.05) is None
    assert Track(4, 0.1).ahead(0, 0.1, 0.1) is None


def test_extrapolation_does_not_take_its_slope_across_a_break() -> None:
    assert track_of((0, 0.0), (20, None), (40, 2.0)).ahead(60 * MS, 0.2, 0.1) == (2.0, -2.0)
    assert track_of((0, 0.0), (150, 2.0)).ahead(160 * MS, 0.2, 0.1) == (2.0, -2.0)
    assert track_of((0, 0.0), (20, None)).ahead(30 * MS, 0.2, 0.1) is None
