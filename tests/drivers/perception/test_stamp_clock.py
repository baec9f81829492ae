"""A camera's stamps in the role's clock: never in the future, never twice, and not biased by slow
arrivals.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.perception.stamp_clock import (
    WRAP_NS,
    Domain,
    StampClock,
    StampConfig,
    StampLine,
    StampRefused,
)

MS = 1_000_000
PERIOD = 20 * MS


def mapped(
    clock: StampClock, stamp_ns: int, domain: Domain, arrival_ns: int, wall_ns: int = 0
) -> int:
    result = clock.to_role(stamp_ns, domain, arrival_ns, wall_ns)
    assert isinstance(result, int), result
    return result


@pytest.mark.parametrize("drift_ppm", [-40.0, 0.0, 40.0])
def test_late_arrivals_of_a_drifting_clock_do_not_move_the_stamps(drift_ppm: float) -> None:
    rng = np.random.default_rng(3)
    clock, errors = StampClock(StampConfig(latency_ns=8 * MS)), []
    for k in range(3000):
        true_ns = k * PERIOD
        own_ns = 5_000_000_000 + round(true_ns * (1 + drift_ppm * 1e-6))
        arrival_ns = true_ns + 8 * MS + round(rng.exponential(3 * MS))
        stamp = clock.to_role(own_ns, Domain.HARDWARE, arrival_ns, 0)
        if isinstance(stamp, int) and k > 50:
            errors.append(stamp - true_ns)
    assert len(errors) > 2900
    assert np.abs(errors).max() < 1 * MS  # of latencies up to 30 ms


def test_the_counter_of_a_d400_begins_anew() -> None:
    line = StampLine()
    # more than three hours
    stamps = [line.next(k * 600_000 * MS % WRAP_NS, Domain.HARDWARE) for k in range(20)]
    assert stamps == [k * 600_000 * MS for k in range(20)]
    wall = StampLine()
    assert wall.next(WRAP_NS, Domain.GLOBAL) == WRAP_NS
    assert wall.next(0, Domain.GLOBAL) is None  # nor does a wall clock


def test_stamps_that_repeat_or_go_back_are_refused() -> None:
    line = StampLine()
    results = [
        line.next(stamp, Domain.HARDWARE) for stamp in (100 * MS, 100 * MS, 90 * MS, 101 * MS)
    ]
    assert results == [100 * MS, None, None, 101 * MS]


def test_a_recording_keeps_its_distances_whatever_the_arrivals() -> None:
    clock = StampClock(StampConfig(50 * MS, follow=False))
    late = (30, 0, 90, 5)
    stamps = [
        mapped(clock, k * PERIOD, Domain.GLOBAL, k * PERIOD + each * MS)
        for k, each in enumerate(late)
    ]
    assert np.diff(stamps).tolist() == [PERIOD] * 3
    assert stamps[0] == (30 - 50) * MS


def test_a_wall_clock_stamp_is_taken_as_it_is() -> None:
    clock = StampClock()
    wall_ns = 1_700_000_000_000 * MS
    assert mapped(clock, wall_ns + 500 * MS, Domain.GLOBAL, 512 * MS, wall_ns) == 500 * MS
    # not from the future
    assert mapped(clock, wall_ns + 533 * MS, Domain.SYSTEM, 532 * MS, wall_ns) == 532 * MS


@pytest.mark.parametrize("step_ms", [-2000, 2000])
def test_a_wall_clock_that_was_set_is_not_followed(step_ms: int) -> None:
    clock = StampClock()
    assert mapped(clock, 100 * MS, Domain.GLOBAL, 110 * MS) == 100 * MS
    assert clock.to_role(120 * MS, Domain.GLOBAL, 130 * MS, step_ms * MS) is StampRefused.CLOCK


@given(
    st.lists(st.tuples(st.integers(-50, 400), st.integers(0, 300)), min_size=1, max_size=30),
    st.sampled_from(Domain),
)
def test_whatever_comes_stamps_grow_and_are_not_after_the_arrival(
    steps: list[tuple[int, int]], domain: Domain
) -> None:
    line, clock, stamp_ns, last = StampLine(), StampClock(), 10_000 * MS, -1
    for step, late in steps:
        stamp_ns += step * MS
        arrival_ns = stamp_ns + late * MS
        own_ns = line.next(stamp_ns, domain)
        result = None if own_ns is None else clock.to_role(own_ns, domain, arrival_ns, 0)
        if isinstance(result, int):
            assert last < result <= arrival_ns
            last = result
