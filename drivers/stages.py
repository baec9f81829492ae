"""The processor time of a program's main thread, by stage of its work."""

from __future__ import annotations

import time
from collections.abc import Generator
from contextlib import contextmanager

from drivers.clock import busy_ns


class Stages:
    """Processor time of one thread by stage of its work. Stages do not contain one another; the rest is in none."""

    def __init__(self) -> None:
        self._spent_ns: dict[str, int] = {}

    @contextmanager
    def __call__(self, stage: str) -> Generator[None, None, None]:
        began_ns = busy_ns()
        try:
            yield
        finally:
            self._spent_ns[stage] = self._spent_ns.get(stage, 0) + busy_ns() - began_ns

    def spent_ns(self) -> dict[str, int]:
        """Since the start: of each stage, of the calling thread as ``thread``, and of all threads as ``program``."""
        return {**self._spent_ns, "thread": busy_ns(), "program": time.process_time_ns()}
