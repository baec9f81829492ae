"""The folder of a run, and what it may take away of an earlier one's."""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Generator, Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path

from drivers.interfaces import PartError
from drivers.text_file import read_file
from missions.ground.held import held_folder
from missions.ground.kernel_cache import can_write
from missions.ground.shown import FolderGone
from path.values import frozen

REMEDY = "name another place with --out"
MOST_SHOWN = 160
MOST_SEARCHED = 1 << 30


@frozen
class RunKind:
    """A kind of run, by the files in its folder.

    Attributes:
        marker: the file that is written first, and says that the folder is a run's.
        results: the files that are made of the logs.
        actors: whose logs, errors and records there are.
    """

    marker: str
    results: tuple[str, ...]
    actors: tuple[str, ...]

    def files(self, folder: Path) -> Iterator[Path]:
        """Yield the files in a folder that have the names of a run's."""
        actors = "|".join(map(re.escape, self.actors))
        logs = re.compile(
            rf"({actors})(\.guard)?(\.\d+)?(\.frames)?\.(mcap|stderr\.txt|state\.json)"
        )
        for file in sorted(folder.iterdir()):
            if file.name in (self.marker, *self.results) or logs.fullmatch(file.name):
                yield file


def new_folder(out: Path | None) -> Path:
    """The folder of a run, made; ``runs/<time>`` by default, and no other run's. Raises
    PartError.
    """
    folder = out or Path("runs") / datetime.now().strftime("%Y%m%d-%H%M%S")
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        if out is None:
            return _next_free(folder)
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise PartError(f"cannot make {_shown(folder)}: {error.strerror}", REMEDY) from error
    return folder


def _next_free(folder: Path) -> Path:
    """Make a folder that was not there: of runs that begin in the same second each has its own.
    Raises OSError.
    """
    free = folder
    number = 1
    while True:
        try:
            free.mkdir()
        except FileExistsError:
            number += 1
            free = folder.with_name(f"{folder.name}-{number}")
        else:
            return free


def _shown(path: Path) -> str:
    """A path as it can be shown: of one that is too long to be any, the ends."""
    text = str(path)
    return (
        text if len(text) <= MOST_SHOWN else f"{text[:60]}...{text[-60:]} ({len(text)} characters)"
    )


@contextmanager
def unless_refused(out: Path | None, *, beside: bool = False) -> Generator[Path, None, None]:
    """The folder of a run, held against other programs while this one writes there.

    Of one that was not there and is empty nothing is left after a refusal.

    Args:
        out: as of ``new_folder``.
        beside: as of ``held_folder``.

    Raises:
        PartError: when it cannot be made, or another program writes there.
        FolderGone: when it was taken away by the time that something was to be written there.
    """
    made = [] if out is None else [each for each in (out, *out.parents) if not _there(each)]
    had_runs = Path("runs").exists()
    folder = new_folder(out)
    if out is None:
        made = [folder] if had_runs else [folder, folder.parent]
    try:
        with held_folder(folder, beside=beside):
            try:
                yield folder
            except FileNotFoundError as error:
                if folder.exists():
                    raise
                raise FolderGone.of(folder) from error
    except PartError:
        for each in made:
            with suppress(OSError):
                each.rmdir()
        raise


def _there(path: Path) -> bool:
    try:
        return path.exists()
    except OSError:  # a name that is too long to be there
        return False


def refuse_foreign(folder: Path, kind: RunKind) -> None:
    """Raise PartError when a folder has files with the names of a run's, and no marker that says
    whose they are.
    """
    there = list(kind.files(folder)) if folder.is_dir() else []
    if there and not _has(folder / kind.marker, '"outcome"'):
        raise PartError(
            f"{folder} holds {_some(there)}, and no {kind.marker} of an earlier run: nothing is written over",
            f"{REMEDY}, or move these files away",
        )


@contextmanager
def claimed(folder: Path, kind: RunKind) -> Generator[None, None, None]:
    """A folder that is a new run's, from its marker on: nothing that an earlier one left may be
    taken for its own.

    Other files stay as they are. Raises PartError when the folder has files with the names of a
    run's and no marker that says whose they are, cannot be written to, or is another program's that
    writes there. A run that is refused leaves no marker.
    """
    marker = folder / kind.marker
    with held_folder(folder):
        refuse_foreign(folder, kind)
        try:
            for file in kind.files(folder):
                file.unlink()
            marker.write_text(json.dumps({"outcome": "unfinished"}) + "\n", "utf-8")
        except OSError as error:
            raise PartError(f"cannot write to {folder}: {error.strerror}", REMEDY) from error
        try:
            yield
        except PartError:
            marker.unlink(missing_ok=True)
            raise


def claim_result(file: Path, *signs: str) -> None:
    """Refuse to write a result over a file that none of the ``signs`` of an earlier one is in.
    Raises PartError.
    """
    check_file(file)
    if file.exists() and not any(_has(file, sign) for sign in signs):
        raise PartError(
            f"{file} is there, and is no earlier result: it is not written over", REMEDY
        )


def check_file(file: Path) -> None:
    """Refuse a file that cannot be one, or be made, before any work is done for it. Raises
    PartError.
    """
    try:
        if file.is_dir():
            raise PartError(f"{_shown(file)} is a folder", "name a file with --out")
        if not can_write(file.parent):
            raise PartError(
                f"cannot write {_shown(file)}: its folder cannot be made, or written to", REMEDY
            )
    except OSError as error:
        raise PartError(f"cannot write {_shown(file)}: {error.strerror}", REMEDY) from error


def claim_folder(folder: Path, marker: str, *signs: str) -> None:
    """Refuse a folder that holds anything, unless its ``marker`` has one of the ``signs`` of an
    earlier result.

    For what writes many files, with names that others use too. Raises PartError.
    """
    there = sorted(folder.iterdir())
    if there and not any(_has(folder / marker, sign) for sign in signs):
        raise PartError(
            f"{folder} holds {_some(there)}, and is no earlier result: nothing is written over",
            REMEDY,
        )


def write_json(file: Path, content: object) -> None:
    """Write what a person may want to read too. Raises OSError."""
    file.write_text(json.dumps(content, indent=2) + "\n", "utf-8")


def discard(folder: Path, kind: RunKind) -> None:
    """Take away a run's files, and its folder if nothing else is in it."""
    with suppress(OSError):
        for file in kind.files(folder):
            file.unlink()
        folder.rmdir()


def _has(file: Path, sign: str) -> bool:
    try:
        return sign.encode() in read_file(file, MOST_SEARCHED)
    except OSError:
        return False


def _some(files: Collection[Path]) -> str:
    names = [file.name for file in files]
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
