"""The rate and the longest gap of a stream, and whether a flight can be flown by it."""

from __future__ import annotations

import pytest

from drivers.arrivals import WINDOW_S, Arrivals, too_slow

NOW_NS = 100 * 10**9


def stream(
    rate_hz: float, *, last_s: float = 0.0, without: tuple[float, float] = (0.0, 0.0)
) -> Arrivals:
    """Return a stream of 10 s until ``last_s`` ago, without what came between two ages."""
    arrivals = Arrivals()
    ages_s = [last_s + k / rate_hz for k in range(round(10.0 * rate_hz))]
    for age_s in reversed(ages_s):
        if not without[0] < age_s < without[1]:
            arrivals.add(NOW_NS - round(age_s * 1e9))
    return arrivals


def test_a_rate_and_its_longest_gap() -> None:
    assert stream(50.0).lately(NOW_NS) == (
        pytest.approx(50.0, abs=1.0),
        pytest.approx(0.02, abs=1e-3),
    )
    assert stream(50.0, without=(0.5, 1.2)).lately(NOW_NS)[1] == pytest.approx(0.7, abs=0.05)
    assert stream(50.0, last_s=1.5).lately(NOW_NS) == (
        pytest.approx(12.5, abs=1.0),
        pytest.approx(1.5),
    )


def test_what_never_came_has_been_missing_all_the_time() -> None:
    assert Arrivals().lately(NOW_NS) == (0.0, WINDOW_S)


@pytest.mark.parametrize(
    ("arrivals", "oldest_s", "slow"),
    [
        (stream(50.0), 0.5, False),
        (stream(5.0), 0.5, False),
        (stream(3.0), 0.5, True),  # one packet lost would end the flight
        (stream(1.0), 0.5, True),
        (stream(1.0), 2.5, False),
        (stream(50.0, without=(0.2, 0.9)), 0.5, True),
        (stream(50.0, last_s=0.6), 0.5, True),
        (Arrivals(), 5.0, True),
    ],
)
def test_whether_a_stream_is_enough_for_a_flight(
    arrivals: Arrivals, oldest_s: float, slow: bool
) -> None:
    words = too_slow({"position": arrivals, "attitude": stream(50.0)}, NOW_NS, oldest_s)
    assert words.startswith("position ") is slow
    assert ("attitude" in words) is False
