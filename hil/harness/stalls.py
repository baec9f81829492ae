"""Programs that stand still in virtual time, while the world, the link and everybody else go on.

Whatever a program has under way knows whose it is: tasks and timers inherit the context in which
they were begun (``PROGRAM``). While a program stands still nothing of it runs. What came due
meanwhile runs when it goes on, in the order in which it came due, as after a SIGSTOP and a SIGCONT:
packets have waited at its socket, and are stamped then.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextvars import Context, ContextVar, copy_context
from functools import partial
from typing import Any, TypeVar

from hil.harness.virtual_time import VirtualTimeLoop

PROGRAM: ContextVar[str] = ContextVar("program", default="")

AnyHandle = TypeVar("AnyHandle", bound=asyncio.Handle)


class _Held:
    """A callback of a program's."""

    __slots__ = ("_args", "_callback", "_loop", "_program", "context", "handle")

    def __init__(
        self,
        loop: StallingLoop,
        program: str,
        callback: Callable[..., Any],
        args: tuple[Any, ...],
        context: Context,
    ) -> None:
        self._loop = loop
        self._program = program
        self._callback = callback
        self._args = args
        self.context = context
        self.handle: asyncio.Handle | None = None

    def __call__(self) -> None:
        assert self.handle is not None
        if self.handle.cancelled():  # while it waited
            return
        if not self._loop.keeps(self._program, self):
            self._callback(*self._args)


class StallingLoop(VirtualTimeLoop):
    """A loop in which ``stand_still`` stops one program. It costs a little more than the plain
    one.
    """

    def __init__(self) -> None:
        super().__init__()
        self._kept: dict[str, list[_Held]] = {}
        self._until_s: dict[str, float] = {}

    def stand_still(self, program: str, for_s: float) -> float:
        """Stop a program; return when it goes on, which is later when it stands still already."""
        until_s = max(self.time() + for_s, self._until_s.get(program, 0.0))
        self._until_s[program] = until_s
        self._kept.setdefault(program, [])
        super().call_at(until_s, self._goes_on, program, context=Context())
        return until_s

    def wake(self, program: str) -> None:
        """Let a program go on at once: it is killed, which needs no turn of its own."""
        self._until_s.pop(program, None)
        for held in self._kept.pop(program, []):
            super().call_soon(held, context=held.context)

    def keeps(self, program: str, held: _Held) -> bool:
        """Return whether a program stands still, and then keeps what was due."""
        if program not in self._kept:
            return False
        self._kept[program].append(held)
        return True

    def _goes_on(self, program: str) -> None:
        if program in self._until_s and self.time() >= self._until_s[program]:
            self.wake(program)

    def call_soon(
        self, callback: Any, *args: Any, context: Context | None = None
    ) -> asyncio.Handle:
        return self._begin(super().call_soon, callback, args, context)

    def call_at(
        self, when: float, callback: Any, *args: Any, context: Context | None = None
    ) -> asyncio.TimerHandle:
        return self._begin(partial(super().call_at, when), callback, args, context)

    def _begin(
        self,
        schedule: Callable[..., AnyHandle],
        callback: Any,
        args: tuple[Any, ...],
        context: Context | None,
    ) -> AnyHandle:
        """Schedules what a program has begun so that it can be kept, and what is nobody's as it
        is.
        """
        context = copy_context() if context is None else context
        program = context.get(PROGRAM, "")
        if not program:
            return schedule(callback, *args, context=context)
        held = _Held(self, program, callback, args, context)
        handle = schedule(held, context=context)
        held.handle = handle
        return handle
