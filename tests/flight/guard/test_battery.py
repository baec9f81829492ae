"""For how long the last level of a battery counts."""

from __future__ import annotations

import pytest

from flight.guard.battery import TELL_S, UNTOLD_S, battery_trouble, untold_s

S = 1_000_000_000
NOW_NS = 100 * S


def test_a_level_that_comes_with_every_state_is_never_untold() -> None:
    assert untold_s(None, NOW_NS) == 0.0
    assert untold_s(NOW_NS - 2 * S, NOW_NS) == pytest.approx(2.0)


def test_the_last_level_counts_for_ten_seconds_to_the_nanosecond() -> None:
    last_ns = NOW_NS - round(UNTOLD_S * S)
    assert battery_trouble(0.9, last_ns, NOW_NS, 0.2) == ""
    assert "90 %" in battery_trouble(0.9, last_ns - 1, NOW_NS, 0.2)


def test_the_crew_is_told_before_the_flight_ends_and_with_time_to_land_it() -> None:
    """A vehicle tells its level every second: two that are missing are worth a word, and half of
    the time is left.
    """
    assert 2.0 < TELL_S <= 0.5 * UNTOLD_S
