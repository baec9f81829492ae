"""Logs of another computer, copied to this one with the scp that is installed: its keys, its names,
its questions.
"""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

from drivers.interfaces import PartError
from missions.ground.shown import tell_line

REMOTE = re.compile(r"(?:[\w.-]+@)?(?P<host>[\w.-]+):(?P<path>[^:]+)")
ANSWER_S = 10  # until a computer answers that it is there


def fetched(named: Path) -> Path:
    """Return what was named, fetched from its computer if it is on another. Raises PartError.

    ``d1:runs/X`` becomes the folder ``d1-X`` in this one. What is there already is not fetched
    again over it.
    """
    remote = REMOTE.fullmatch(str(named))
    if remote is None or named.exists():
        return named
    here = Path(f"{remote['host']}-{Path(remote['path']).name}")
    if here.suffix == ".mcap":
        raise PartError(
            f"{named} is a log on another computer",
            "name its folder: logs are known by their names",
        )
    if here.exists():
        raise PartError(
            f"{here} is there already, and {named} would become it",
            f"name {here} instead, or remove it",
        )
    scp = shutil.which("scp")
    if scp is None:
        raise PartError(
            f"{named} is on another computer, and scp is not installed", "install OpenSSH's client"
        )
    tell_line(f"fetching {named}")
    done = subprocess.run(
        [scp, "-r", "-q", "-o", f"ConnectTimeout={ANSWER_S}", "--", str(named), str(here)],
        stderr=subprocess.PIPE, text=True, check=False,
    )  # fmt: skip
    if done.returncode != 0:
        said = done.stderr.strip() or f"scp ended with {done.returncode}"
        kept = f"; what came of it is in {here}: remove it" if here.exists() else ""
        raise PartError(
            f"{named} was not fetched: {said}", f"try `scp -r {named} {here}` yourself{kept}"
        )
    return here
