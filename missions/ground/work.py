"""Long work on all cores, with a bar that shows how far it is."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from multiprocessing import get_context, parent_process
from threading import Thread
from typing import TextIO, TypeVar

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

Item = TypeVar("Item")
Result = TypeVar("Result")

# pieces submitted for each process, so that none waits and an interrupt has little to cancel
AHEAD = 3


def call(piece: Callable[[], Result]) -> Result:
    """Run a piece that has its arguments with it, such as a ``functools.partial``."""
    return piece()


class Work:
    """Runs the pieces of something long. One pool of processes serves all of them, so that kernels
    are loaded once.

    Pieces are functions at module level with picklable arguments and results. Each must take its
    randomness from its arguments alone: results do not depend on the number of processes.
    """

    def __init__(self, jobs: int, bars: Bars) -> None:
        self._jobs = jobs
        self._bars = bars
        self._pool: ProcessPoolExecutor | None = None

    @property
    def jobs(self) -> int:
        """Processes at a time."""
        return self._jobs

    def map(
        self,
        what: str,
        piece: Callable[[Item], Result],
        items: Sequence[Item],
    ) -> list[Result]:
        """The results in the order of the items; ``what`` names the work on its bar.

        Raises what a piece raised; the pieces that have not begun are given up then.
        """
        with self._bars.bar(what, len(items)) as advance:
            if self._jobs == 1 or len(items) <= 1:
                return list(_stepped(map(piece, items), advance))
            results = dict(self._on_all_cores(piece, items, advance))
            return [results[index] for index in range(len(items))]

    def stream(
        self,
        what: str,
        piece: Callable[[Item], Result],
        items: Sequence[Item],
    ) -> Iterator[Result]:
        """The results as they come, for what is kept at once. Raises as ``map``."""
        with self._bars.bar(what, len(items)) as advance:
            if self._jobs == 1:
                yield from _stepped(map(piece, items), advance)
            else:
                for _, result in self._on_all_cores(piece, items, advance):
                    yield result

    def steps(self, what: str, items: Sequence[Item]) -> Iterator[Item]:
        """The items one by one, with a bar: work that must stay in this process, such as
        timings.
        """
        with self._bars.bar(what, len(items)) as advance:
            yield from _stepped(items, advance)

    def _on_all_cores(
        self,
        piece: Callable[[Item], Result],
        items: Sequence[Item],
        advance: Callable[[], None],
    ) -> Iterator[tuple[int, Result]]:
        if self._pool is None:
            self._pool = ProcessPoolExecutor(
                self._jobs,
                mp_context=get_context("spawn"),
                initializer=_quiet_worker,
            )
        running: dict[Future[Result], int] = {}
        waiting = iter(enumerate(items))
        left = len(items)
        try:
            while left:
                while (
                    len(running) < AHEAD * self._jobs
                    and (following := next(waiting, None)) is not None
                ):
                    index, item = following
                    running[self._pool.submit(piece, item)] = index
                for done in wait(running, return_when=FIRST_COMPLETED).done:
                    left -= 1
                    yield running.pop(done), done.result()
                    advance()
        finally:
            for future in running:
                future.cancel()

    def close(self) -> None:
        """End the processes; those that still work finish their piece."""
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)
            self._pool = None


class Bars:
    """Bars on a stream: live when it is a terminal, a line at each tenth when it is not."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    @contextmanager
    def bar(self, what: str, total: int) -> Generator[Callable[[], None], None, None]:
        """A bar of ``total`` steps; call what it gives after each."""
        if self._stream.isatty():
            columns = (
                TextColumn("{task.description}"),
                BarColumn(),
                MofNCompleteColumn(),
                TimeElapsedColumn(),
                TimeRemainingColumn(),
            )
            with Progress(*columns, console=Console(file=self._stream)) as progress:
                task = progress.add_task(what, total=total)
                yield lambda: progress.advance(TaskID(task))
            return
        done = 0

        def advance() -> None:
            nonlocal done
            done += 1
            if done == total or done * 10 // total > (done - 1) * 10 // total:
                self._stream.write(f"{what}: {done}/{total}\n")
                self._stream.flush()

        yield advance


@contextmanager
def open_work(jobs: int, stream: TextIO | None = None) -> Generator[Work, None, None]:
    """Work with ``jobs`` processes (0: one a core), ended at the end of the block."""
    work = Work(jobs or os.cpu_count() or 1, Bars(stream or sys.stdout))
    try:
        yield work
    finally:
        work.close()


def belong_to_parent() -> None:
    """In a process of a pool: Ctrl-C is the parent's to handle, and the process ends when its
    parent does.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Thread(target=_end_with_parent, daemon=True).start()


def _quiet_worker() -> None:
    """Libraries shall not start threads on top of one process a core."""
    belong_to_parent()
    import cv2  # noqa: PLC0415 (only workers need it here)

    cv2.setNumThreads(1)


def _end_with_parent() -> None:
    """A parent that was killed shuts no pool down; its processes would work on for nobody."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _stepped(items: Iterable[Item], advance: Callable[[], None]) -> Iterator[Item]:
    for item in items:
        yield item
        advance()
