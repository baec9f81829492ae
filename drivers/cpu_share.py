"""A share of one core for chosen processes, held to by the kernel: a control group of our own, of
version 1 or 2.

The kernel lets the group run for ``share`` of every period and then stops all of it until the next:
on the whole a slower core, and short periods make it one for a frame too. What such a process
starts is in its group as well.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Self

from drivers.interfaces import PartError
from path.values import frozen

PREFIX = "path-handoff-share"
SHORTEST_US = 1000  # of a quota, by the kernel
PERIOD_US = 10_000
LEAST = 0.02
_WAY_OUT = "run it as root where control groups can be written to, or leave --slow and the rig's `slow` out"


@frozen
class Hierarchy:
    """The control groups that limit processor time, as mounted here.

    Attributes:
        version: 1 or 2.
        folders: in which a group may be made, the wanted one first.
    """

    version: int
    folders: tuple[Path, ...]


def hierarchies(proc: Path = Path("/proc/self")) -> Iterator[Hierarchy]:
    """Yield those that this process is in: first version 1, which then has the controller, and
    then version 2.
    """
    own = [line.split(":", 2) for line in (proc / "cgroup").read_text("utf-8").splitlines()]
    mounts = [line.split() for line in (proc / "mountinfo").read_text("utf-8").splitlines()]
    for _, controllers, path in own:
        if "cpu" in controllers.split(","):
            for root, point, kind, options in map(_mount, mounts):
                if kind == "cgroup" and "cpu" in options:
                    yield Hierarchy(1, (_below(point, root, path),))
    for _, controllers, path in own:
        if not controllers:
            for root, point, kind, _ in map(_mount, mounts):
                if kind == "cgroup2":
                    here = _below(point, root, path)
                    above = [
                        folder
                        for folder in here.parents
                        if folder == point or point in folder.parents
                    ]
                    yield Hierarchy(2, (here, *above))


def _mount(fields: Sequence[str]) -> tuple[str, Path, str, Sequence[str]]:
    """Root, place, kind and options of a mount, from its line in ``mountinfo``."""
    rest = fields[fields.index("-") + 1 :]
    return fields[3], Path(fields[4]), rest[0], rest[-1].split(",")


def _below(
    point: Path,
    root: str,
    path: str,
) -> Path:
    """The folder of a group, of which the mount may show only a part."""
    inside = path.removeprefix(root) if root != "/" else path
    return point / inside.strip("/")


class CpuShare:
    """A group of processes that get ``share`` of one core together. Entering it makes it, leaving
    it removes it.

    The group is named after this process. Groups of programs that were killed before they could
    remove theirs go when the next one is made.
    """

    def __init__(
        self,
        name: str,
        share: float,
        found: Sequence[Hierarchy] | None = None,
    ) -> None:
        if not LEAST <= share <= 1.0:
            raise PartError(
                f"a share of {share:g} of a core is not within {LEAST:g}..1",
                "0.2 is a fifth of one core",
            )
        self._name = f"{PREFIX}-{os.getpid()}-{_began(os.getpid())}-{name}"
        self._period_us = max(PERIOD_US, round(SHORTEST_US / share))
        self._quota_us = max(SHORTEST_US, round(share * self._period_us))
        self._found = found
        self._version = 0
        self.folder: Path | None = None

    def __enter__(self) -> Self:
        """Make the group. Raises PartError, with the reasons, where this process may not."""
        reasons: list[str] = []
        for hierarchy in hierarchies() if self._found is None else self._found:
            for parent in hierarchy.folders:
                try:
                    _let_limit(parent, hierarchy.version)
                    remove_leftovers(parent)
                    self._make(parent / self._name, hierarchy.version)
                except OSError as error:
                    reasons.append(f"{error.filename or parent}: {error.strerror or error}")
                else:
                    return self
        raise PartError(
            f"a share of a core needs a control group: {'; '.join(reasons) or 'none is mounted'}",
            _WAY_OUT,
        )

    def __exit__(self, *_: object) -> None:
        """Remove the group; its processes have ended by then, or are let out."""
        if self.folder is not None:
            _remove(self.folder)
            self.folder = None

    def _make(self, folder: Path, version: int) -> None:
        folder.mkdir()
        try:
            if version == 1:
                (folder / "cpu.cfs_period_us").write_text(str(self._period_us))
                (folder / "cpu.cfs_quota_us").write_text(str(self._quota_us))
                (folder / "cpu.shares").write_text(str(10 * 1024))  # neighbours take nothing of it
            else:
                (folder / "cpu.max").write_text(f"{self._quota_us} {self._period_us}")
                (folder / "cpu.weight").write_text("1000")
        except OSError:
            _remove(folder)
            raise
        self.folder = folder
        self._version = version

    def add(self, pid: int) -> None:
        """Put a process with all its threads into the group; one that has ended already is left
        alone.
        """
        assert self.folder is not None
        with suppress(ProcessLookupError):
            (self.folder / "cgroup.procs").write_text(str(pid))

    def stopped_s(self) -> float:
        """Return how long the group had work to do and was stopped because its share was used
        up.
        """
        assert self.folder is not None
        key, scale = ("throttled_time", 1e-9) if self._version == 1 else ("throttled_usec", 1e-6)
        for line in (self.folder / "cpu.stat").read_text("utf-8").splitlines():
            name, _, value = line.partition(" ")
            if name == key:
                return int(value) * scale
        return 0.0


def _let_limit(parent: Path, version: int) -> None:
    """Make sure that groups below this one can be limited. Raises OSError with the reason."""
    if version == 1:
        return
    if "cpu" not in (parent / "cgroup.controllers").read_text("utf-8").split():
        raise OSError(0, "has no cpu controller", str(parent))
    given = parent / "cgroup.subtree_control"
    if "cpu" not in given.read_text("utf-8").split():
        given.write_text("+cpu")


def remove_leftovers(parent: Path) -> None:
    """Remove the groups of ours whose makers are gone. What still runs in one is let out of it: it
    has to end.
    """
    for folder in parent.glob(f"{PREFIX}-*"):
        pid, began = folder.name.removeprefix(f"{PREFIX}-").split("-")[:2]
        if folder.stat().st_uid == os.geteuid() and _began(int(pid)) != began:
            _remove(folder)


def _remove(folder: Path) -> None:
    """Remove a group. Its processes, if there still are any, go on in the one above."""
    try:
        left = (folder / "cgroup.procs").read_text("utf-8").split()
    except OSError:
        left = []
    for pid in left:
        # it ended just now, or it may not: then the folder stays, and the next run tries again
        with suppress(OSError):
            (folder.parent / "cgroup.procs").write_text(pid)
    with suppress(OSError):
        folder.rmdir()


def _began(pid: int) -> str:
    """The instant a process began, in the kernel's ticks: with its number its name for good. ""
    when it is gone.
    """
    try:
        return Path(f"/proc/{pid}/stat").read_text("utf-8").rpartition(")")[2].split()[19]
    except (OSError, IndexError):
        return ""
