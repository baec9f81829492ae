"""An asyncio event loop in which sleeping costs nothing: time jumps to the next scheduled event.

The same coroutines run here and on a real loop; as every wake-up happens in the order of its due
time, and nothing depends on the wall clock, one seed gives one history.
"""

from __future__ import annotations

import asyncio
import selectors
from collections.abc import Callable
from typing import Any

ASK_EVERY = 64


class _JumpingSelector(selectors.DefaultSelector):
    """Never waits: reports what is ready (signals arrive this way) or moves the loop's clock by the
    time-out.

    The system is asked once in ``ASK_EVERY`` calls, which is still every few milliseconds, and
    whenever nothing else is left to do.
    """

    loop: VirtualTimeLoop
    _calls = 0

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        self._calls += 1
        ready: list[tuple[selectors.SelectorKey, int]] = []
        if timeout is None or self._calls % ASK_EVERY == 0:
            ready = super().select(0)
        if ready:
            return ready
        if timeout is None:
            raise RuntimeError(
                "every task waits for something that no timer, and no input, will bring about"
            )
        if timeout > 0:
            self.loop.jump(timeout)
        return ready


class VirtualTimeLoop(asyncio.SelectorEventLoop):
    """``time()`` starts at 0 s and advances only when everything waits."""

    def __init__(self) -> None:
        self._now_s = 0.0
        selector = _JumpingSelector()
        selector.loop = self
        super().__init__(selector)

    def time(self) -> float:
        return self._now_s

    def jump(self, seconds: float) -> None:
        """Advance the clock; only the selector calls this."""
        self._now_s += seconds


def run_virtual(main: Any, loop_factory: Callable[[], VirtualTimeLoop] = VirtualTimeLoop) -> Any:
    """Run a coroutine to its end in virtual time and return its result."""
    with asyncio.Runner(loop_factory=loop_factory) as runner:
        return runner.run(main)
