"""What is changed: a room's files, or the lines of a change, and the tests that ought to notice
(``rooms.toml``).
"""

from __future__ import annotations

import random
import re
import subprocess
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.mutants.operators import Mutation, mutations

TABLE = Path(__file__).with_name("rooms.toml")
PRODUCTION = ("path/", "drivers/", "flight/", "missions/", "hil/")
_HUNK = re.compile(r"@@ -\S+ \+(\d+)(?:,(\d+))? @@")


class TableError(Exception):
    """What was asked for cannot be tried, and why."""


@dataclass(frozen=True, slots=True)
class FileTests:
    """A file, its room, and the tests that are there for it, those of its own name first.

    ``slow``: tests that are run on what the others do not notice.
    """

    file: str
    tests: tuple[str, ...]
    room: str = ""
    slow: tuple[str, ...] = ()

    @property
    def module(self) -> str:
        return self.file.removesuffix(".py").replace("/", ".")


@dataclass(frozen=True, slots=True)
class Room:
    """Files and folders, and the tests that are there for them; ``slow``: those that wait in real
    time.
    """

    name: str
    files: tuple[str, ...]
    tests: tuple[str, ...]
    slow: tuple[str, ...] = ()

    def holds(self, file: str) -> bool:
        return any(file == own or file.startswith(f"{own.rstrip('/')}/") for own in self.files)


@dataclass(frozen=True, slots=True)
class Table:
    """``rooms.toml``: rooms in their order, and the changes that change nothing, with the reason.

    ``equivalent``: by name. ``arbitrary``: by file, or file and function or constant, whose numbers
    may be any.
    """

    rooms: tuple[Room, ...]
    equivalent: Mapping[str, str] = field(default_factory=dict[str, str])
    arbitrary: Mapping[str, str] = field(default_factory=dict[str, str])

    def room(self, name: str) -> Room:
        """Raises TableError."""
        for room in self.rooms:
            if room.name == name:
                return room
        raise TableError(
            f"there is no room {name!r}: one of {', '.join(room.name for room in self.rooms)}"
        )

    def why_the_same(self, mutation: Mutation) -> str:
        """Return why a change changes nothing; empty when it does."""
        if mutation.operator == "number":
            for place in (mutation.file, f"{mutation.file} {mutation.where}"):
                if place in self.arbitrary:
                    return self.arbitrary[place]
        return self.equivalent.get(mutation.name, "")


def load_table(path: Path = TABLE) -> Table:
    told: Any = tomllib.loads(path.read_text("utf-8"))
    rooms = tuple(
        Room(one["name"], tuple(one["files"]), tuple(one["tests"]), tuple(one.get("slow", ())))
        for one in told["room"]
    )
    equivalent = {one["name"]: one["why"] for one in told.get("equivalent", ())}
    return Table(rooms, equivalent, {one["place"]: one["why"] for one in told.get("arbitrary", ())})


def suite_for(table: Table, file: str, root: Path) -> FileTests | None:
    """The tests for a file: its room's, or else those of the folder that mirrors its own; None when
    there are none.
    """
    for room in table.rooms:
        if room.holds(file):
            slow = _nearest_first(room.slow, file, root)
            quick = [each for each in _nearest_first(room.tests, file, root) if each not in slow]
            return FileTests(file, tuple(quick), room.name, slow)
    folder = Path(file).parent
    while folder.parts:
        mirror = Path("tests") / folder
        if any((root / mirror).rglob("test_*.py")):
            return FileTests(
                file, _nearest_first((mirror.as_posix(),), file, root), folder.as_posix()
            )
        folder = folder.parent
    return None


def _nearest_first(places: Sequence[str], file: str, root: Path) -> tuple[str, ...]:
    """Every test file of some places, those that are called like the file before the others. A
    place may be one test.
    """
    found: list[str] = []
    for place in places:
        if "::" in place:
            found.append(place)
            continue
        inside = (
            sorted((root / place).rglob("test_*.py")) if (root / place).is_dir() else [root / place]
        )
        found += [each.relative_to(root).as_posix() for each in inside]
    stem = Path(file).stem
    return tuple(sorted(dict.fromkeys(found), key=lambda each: stem not in Path(each).stem))


Chosen = list[tuple[FileTests, Mutation]]


def of_room(table: Table, room: Room, root: Path) -> Chosen:
    """All changes of a room's files. Raises TableError."""
    files: list[str] = []
    for own in room.files:
        place = root / own
        if not place.exists():
            raise TableError(f"there is no {own} here: run it in a checkout, and see rooms.toml")
        inside = sorted(place.rglob("*.py")) if place.is_dir() else [place]
        files += [each.relative_to(root).as_posix() for each in inside]
    every: Chosen = []
    for file in files:
        tested = suite_for(table, file, root)
        if tested is not None and tested.room == room.name:
            every += [(tested, one) for one in mutations(file, (root / file).read_text("utf-8"))]
    return every


def of_change(table: Table, since: str, root: Path) -> tuple[Chosen, list[str]]:
    """All changes of the lines that differ from a revision, and the files among them that no test
    is there for.

    Raises TableError.
    """
    every: Chosen = []
    untested: list[str] = []
    for file, lines in changed_lines(since, root).items():
        tested = suite_for(table, file, root)
        if tested is None:
            untested.append(file)
            continue
        found = mutations(file, (root / file).read_text("utf-8"))
        every += [(tested, one) for one in found if one.line in lines]
    return every, untested


def changed_lines(since: str, root: Path) -> dict[str, set[int]]:
    """The lines of production code that differ from a revision, by file, as they are numbered
    now.
    """
    command = ["git", "diff", "--unified=0", "--no-color", "--relative", since, "--", "*.py"]
    ran = subprocess.run(command, cwd=root, capture_output=True, text=True, check=False)
    if ran.returncode != 0:
        raise TableError(ran.stderr.strip())
    changed: dict[str, set[int]] = {}
    file = ""
    for line in ran.stdout.splitlines():
        if line.startswith("+++ "):
            file = line.removeprefix("+++ ").removeprefix("b/")
        hunk = _HUNK.match(line)
        if hunk is not None and file.startswith(PRODUCTION):
            first, count = int(hunk[1]), int(hunk[2] or 1)
            changed.setdefault(file, set()).update(range(first, first + count))
    return {name: lines for name, lines in changed.items() if lines}


def sample(every: Chosen, number: int, seed: int) -> Chosen:
    """So many of all changes, by seed. Each file contributes in proportion to how many it has, in
    their order.
    """
    rng = random.Random(f"mutants {seed}")
    numbers = list(range(len(every)))
    rng.shuffle(numbers)
    return [every[at] for at in sorted(numbers[:number])]
