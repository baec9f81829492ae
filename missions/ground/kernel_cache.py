"""The cache of numba's compiled code: beside the source, in the user's cache folder, or else in a
folder of our own.

Where neither of the first two can be written to, numba does not compile at all: a read-only install
and an account without a home, as services and containers have them.
"""

from __future__ import annotations

import os
import stat
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

VARIABLE = "NUMBA_CACHE_DIR"
TEMPORARY = "temporary files have no place"
INSTALLED = Path(__file__).resolve().parents[2]


def usual_folders() -> tuple[Path, ...]:
    """Return the folders in which numba looks by itself."""
    cache = users_cache()
    return (INSTALLED / "path",) if cache is None else (INSTALLED / "path", cache)


def users_cache() -> Path | None:
    """Return the user's cache folder; None for an account without a home, as containers have them
    by number.
    """
    named = os.environ.get("XDG_CACHE_HOME")
    if named:
        return Path(named)
    try:
        return Path("~/.cache").expanduser()
    except RuntimeError:
        return None


def have_kernel_cache(usual: Sequence[Path] | None = None, temporary: Path | None = None) -> None:
    """Name a folder of our own for this program and those it starts when none of the usual ones can
    be written to.

    Raises PartError when none can.
    """
    folders = usual_folders() if usual is None else usual
    wanted = os.environ.get(VARIABLE)
    if wanted or any(can_write(folder) for folder in folders):
        if wanted and not can_write(Path(wanted)):
            _refuse(f"{VARIABLE} = {wanted}")
        return
    own = (temporary or Path(tempfile.gettempdir())) / f"path-handoff-kernels-{os.getuid()}"
    try:
        own.mkdir(mode=0o700, exist_ok=True)
        there = own.lstat()
    except OSError:
        _refuse(", ".join(map(str, (*folders, own))))
    if (
        not stat.S_ISDIR(there.st_mode)
        or there.st_uid != os.getuid()
        or stat.S_IMODE(there.st_mode) & 0o022
    ):
        _refuse(f"{own}, which belongs to somebody else,")  # what is in it would be run
    os.environ[VARIABLE] = str(own)


def have_temporary_folder() -> None:
    """Raise PartError when temporary files have no place, or not the one that was named.

    Python looks for another place by itself; two programs of one flight would then look for each
    other's keys and locks in two.
    """
    for variable in ("TMPDIR", "TEMP", "TMP"):
        named = os.environ.get(variable)
        if named and not (Path(named).is_dir() and can_write(Path(named))):
            _refuse(
                f"{variable} = {named}",
                f"set {variable} to a folder that can be written to, or unset it",
                TEMPORARY,
            )
        if named:
            break
    try:
        tempfile.gettempdir()
    except FileNotFoundError as error:
        where = str(error).partition("in ")[2] or "/tmp"
        _refuse(
            where, "free some disk, or set TMPDIR to a folder that can be written to", TEMPORARY
        )


def can_write(folder: Path) -> bool:
    """Return whether a file can be made in a folder, or the folder itself."""
    try:
        existing = next((path for path in (folder, *folder.parents) if path.exists()), None)
        if existing is None or not existing.is_dir() or not os.access(existing, os.W_OK | os.X_OK):
            return False
        with tempfile.TemporaryFile(dir=existing):
            return True
    except OSError:  # also of a folder in which this user may not look: another's home
        return False


def _refuse(what: str, fix: str = "", no_place: str = "compiled kernels have no place") -> NoReturn:
    from drivers.interfaces import PartError  # noqa: PLC0415 (numpy behind it takes longer than all the rest)

    usual = f"set {VARIABLE} to a folder that can be written to, in which nobody else can write"
    raise PartError(f"{what} cannot be written to: {no_place}", fix or usual)
