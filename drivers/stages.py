"""The processor time of a program's main thread, by stage of its work."""

from __future__ import annotations

import time

from drivers.clock import busy_ns


class _Stage:
    """A context that adds up what its body spends. Written out: a generator takes three times as
    long.
    """

    __slots__ = ("_began_ns", "spent_ns")

    def __init__(self) -> None:
        self._began_ns = self.spent_ns = 0

    def __enter__(self) -> None:
        self._began_ns = busy_ns()

    def __exit__(self, *_: object) -> None:
        self.spent_ns += busy_ns() - self._began_ns


class Stages:
    """Processor time of one thread by stage of its work. Stages do not contain one another; the
    rest is in none.
    """

    def __init__(self) -> None:
        self._stages: dict[str, _Stage] = {}

    def __call__(self, stage: str) -> _Stage:
        """Return the context whose body is the stage: the same one every time."""
        found = self._stages.get(stage)
        if found is None:
            found = self._stages[stage] = _Stage()
        return found

    def spent_ns(self) -> dict[str, int]:
        """Since the start: of each stage, of the calling thread as ``thread``, and of all threads
        as ``program``.
        """
        spent_ns = {name: stage.spent_ns for name, stage in self._stages.items()}
        return {**spent_ns, "thread": busy_ns(), "program": time.process_time_ns()}
