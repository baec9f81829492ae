"""A clock that is set goes on evenly, and what it was set by is known."""

from __future__ import annotations

import asyncio
import threading
import time

import pytest

from drivers.steady_clock import STEP_NS, SteadyClock
from hil.harness.virtual_time import run_virtual

S = 1_000_000_000


class SetClock:
    """A clock that can be set, of the running loop or of the computer."""

    def __init__(self) -> None:
        self.set_by_ns = 0
        # of the next readings: the program was put aside after it had read the clock
        self.late_ns: list[int] = []

    def now_ns(self) -> int:
        try:
            now_s = asyncio.get_running_loop().time()
        except RuntimeError:
            now_s = time.monotonic()
        late_ns = self.late_ns.pop() if self.late_ns else 0
        return round(now_s * 1e9) + self.set_by_ns - late_ns


@pytest.mark.parametrize(
    "steps", [(5 * S,), (-5 * S,), (STEP_NS + 1,), (3600 * S, -7200 * S), (-S, -S, S)]
)
def test_a_clock_that_is_set_goes_on_evenly(steps: tuple[int, ...]) -> None:
    async def main() -> None:
        inner = SetClock()
        clock = SteadyClock(inner)
        begun_ns = clock.now_ns()
        for number, step_ns in enumerate(steps, start=1):
            inner.set_by_ns += step_ns
            await asyncio.sleep(1.0)
            assert clock.now_ns() == begun_ns + number * S
            assert clock.set_by_ns == sum(steps[:number])

    run_virtual(main())


def test_a_clock_that_drifts_is_followed() -> None:
    async def main() -> None:
        inner = SetClock()
        clock = SteadyClock(inner)
        clock.now_ns()
        for _ in range(100):
            inner.set_by_ns += STEP_NS // 2
            await asyncio.sleep(1.0)
            clock.now_ns()
        assert clock.set_by_ns == 0

    run_virtual(main())


@pytest.mark.parametrize("looks", [1, 2, 3])
def test_a_program_that_was_put_aside_between_two_readings_is_no_step(looks: int) -> None:
    async def main() -> None:
        inner = SetClock()
        clock = SteadyClock(inner)
        begun_ns = clock.now_ns()
        inner.late_ns = [S] * looks
        assert clock.now_ns() == begun_ns
        assert clock.set_by_ns == 0

    run_virtual(main())


def test_a_step_is_counted_once_whoever_reads_the_clock() -> None:
    inner = SetClock()
    clock = SteadyClock(inner)
    clock.now_ns()
    gate = threading.Barrier(8)

    def read() -> None:
        gate.wait()
        for _ in range(200):
            clock.now_ns()

    inner.set_by_ns = 10 * S
    threads = [threading.Thread(target=read) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert clock.set_by_ns == pytest.approx(10 * S, abs=S // 100)


def test_a_steady_clock_is_not_wrapped_again() -> None:
    clock = SteadyClock(SetClock())
    assert SteadyClock.of(clock) is clock
