"""The memory and the processor time of a flight's programs, from /proc while it goes on."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from path.values import frozen

PROC = Path("/proc")
_TICKS_PER_S = os.sysconf("SC_CLK_TCK")
_ROLES = ("sender", "receiver")


@frozen
class ProgramSample:
    """One program at one time.

    Attributes:
        private_mib: memory that is its own; what programs share, such as camera images, is not in
            it.
        cpu_s: processor time of its threads since they began, by thread name.
    """

    time_s: float
    private_mib: float
    cpu_s: dict[str, float]


@dataclass(slots=True)
class Watch:
    """Samples of every descendant of a process, by a name that a reader knows, taken in a thread of
    its own.

    Args:
        period_s: between samples.
        now_s: clock of the samples.
        wanted: whether samples are wanted at this time.
        sampled: told after every sample that was wanted.
    """

    period_s: float
    now_s: Callable[[], float]
    wanted: Callable[[], bool]
    sampled: Callable[[], object]
    samples: dict[str, list[ProgramSample]] = field(default_factory=dict[str, list[ProgramSample]])
    _ending: threading.Event = field(default_factory=threading.Event)
    _thread: threading.Thread | None = None

    def __enter__(self) -> Watch:
        self._thread = threading.Thread(target=self._run, name="watch", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        if self._thread is not None:
            self._thread.join()

    def _run(self) -> None:
        while not self._ending.wait(self.period_s):
            if self.wanted():
                self.take()
                self.sampled()

    def take(self) -> None:
        """One sample of every program that is there."""
        for process, name in programs(os.getpid()):
            try:
                sample = ProgramSample(self.now_s(), _private_mib(process), dict(_cpu(process)))
            except (OSError, ValueError):
                continue  # it ended while it was looked at
            self.samples.setdefault(name, []).append(sample)


def programs(ancestor: int) -> Iterator[tuple[int, str]]:
    """Descendants of a process that fly, guard, or are the world: (pid, name)."""
    parents = dict(_parents())
    names = dict[int, str]()
    for process in sorted(parents):
        if ancestor in _line(process, parents):
            names[process] = _name(process)
    for process, name in names.items():
        if name == "mavsdk_server":
            yield process, f"MAVSDK of the {names.get(parents[process], '?')}"
        elif name:
            yield process, name


def _parents() -> Iterator[tuple[int, int]]:
    for entry in PROC.iterdir():
        if entry.name.isdigit():
            try:
                yield int(entry.name), int(_stat(entry)[1])
            except (OSError, IndexError, ValueError):
                continue


def _line(process: int, parents: dict[int, int]) -> Iterator[int]:
    while (process := parents.get(process, 0)) > 0:
        yield process


def _name(process: int) -> str:
    try:
        words = (
            (PROC / str(process) / "cmdline").read_bytes().decode("utf-8", "replace").split("\0")
        )
    except OSError:
        return ""
    if any(word.endswith("mavsdk_server") for word in words[:1]):
        return "mavsdk_server"
    if "hil.harness.realtime.handoff_world" in words:
        return "world"
    role = next((role for role in _ROLES if role in words), "")
    return f"guard of the {role}" if role and "guard" in words else role


def _private_mib(process: int) -> float:
    for line in (PROC / str(process) / "status").read_text().splitlines():
        if line.startswith("RssAnon:"):
            return int(line.split()[1]) / 1024.0
    raise ValueError(f"no RssAnon of process {process}")


def _cpu(process: int) -> Iterator[tuple[str, float]]:
    """Yield the processor time by thread name; threads of one name together."""
    spent: dict[str, float] = {}
    for task in (PROC / str(process) / "task").iterdir():
        fields = _stat(task)
        name = (task / "comm").read_text().strip()
        name = "main" if task.name == str(process) else name
        spent[name] = spent.get(name, 0.0) + (int(fields[11]) + int(fields[12])) / _TICKS_PER_S
    yield from spent.items()


def _stat(folder: Path) -> list[str]:
    """Fields from the state on (proc(5)); the name before them may hold spaces and brackets."""
    return (folder / "stat").read_text().rpartition(")")[2].split()
