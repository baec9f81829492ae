"""A camera's stamps in the role's clock: never in the future, never twice, and not biased by slow arrivals."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.stamp_clock import WRAP_NS, Domain, Refused, StampClock, StampConfig

MS = 1_000_000
PERIOD = 20 * MS


def mapped(clock: StampClock, stamp_ns: int, domain: Domain, arrival_ns: int, wall_ns: int = 0) -> int:
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
    clock = StampClock()
    first = mapped(clock, WRAP_NS - 10 * MS, Domain.HARDWARE, 1000 * MS)
    second = mapped(clock, 10 * MS, Domain.HARDWARE, 1020 * MS)
    assert second - first == 20 * MS


def test_a_wall_clock_stamp_is_taken_as_it_is() -> None:
    clock = StampClock()
    wall_ns = 1_700_000_000_000 * MS
    assert mapped(clock, wall_ns + 500 * MS, Domain.GLOBAL, 512 * MS, wall_ns) == 500 * MS
    assert mapped(clock, wall_ns + 533 * MS, Domain.SYSTEM, 532 * MS, wall_ns) == 532 * MS  # not from the future


@pytest.mark.parametrize("step_ms", [-2000, 2000])
def test_a_wall_clock_that_was_set_is_not_followed(step_ms: int) -> None:
    clock = StampClock()
    assert mapped(clock, 100 * MS, Domain.GLOBAL, 110 * MS) == 100 * MS
    assert clock.to_role(120 * MS, Domain.GLOBAL, 130 * MS, step_ms * MS) is Refused.CLOCK
    assert clock.refused[Refused.CLOCK] == 1


@pytest.mark.parametrize("domain", Domain)
@pytest.mark.parametrize("again_ms", [100, 90])
def test_a_stamp_that_repeats_or_goes_back_is_refused(domain: Domain, again_ms: int) -> None:
    clock = StampClock()
    mapped(clock, 100 * MS, domain, 110 * MS)
    assert clock.to_role(again_ms * MS, domain, 130 * MS, 0) is Refused.OLD
    assert mapped(clock, 140 * MS, domain, 150 * MS) == 140 * MS + (10 * MS if domain is Domain.HARDWARE else 0)
    assert clock.refused[Refused.OLD] == 1


@settings(max_examples=100)
@given(
    st.lists(st.tuples(st.integers(-50, 400), st.integers(0, 300)), min_size=1, max_size=30), st.sampled_from(Domain)
)
def test_whatever_comes_stamps_grow_and_are_not_after_the_arrival(steps: list[tuple[int, int]], domain: Domain) -> None:
    clock, stamp_ns, last, refused = StampClock(), 10_000 * MS, -1, 0
    for step, late in steps:
        stamp_ns += step * MS
        arrival_ns = stamp_ns + late * MS
        result = clock.to_role(stamp_ns, domain, arrival_ns, 0)
        if isinstance(result, Refused):
            refused += 1
        else:
            assert last < result <= arrival_ns
            last = result
    assert sum(clock.refused.values()) == refused
