"""``path-handoff rigs --new``: a commented rig for the field, and the key of its link.

What a crew has to measure is left open in it, and refused until it is filled in.
"""

from __future__ import annotations

import os
import re
import secrets
from importlib.resources import files
from pathlib import Path
from typing import TextIO

from drivers.interfaces import PartError
from missions.ground.rigs import FOLDER

TEMPLATE = "rig_template.toml"
KEY_BYTES = 32
PARAMETERS = {
    "px4": (
        "COM_RC_IN_MODE = 0 # the radio alone",
        "COM_RC_OVERRIDE = 3 # grabbed sticks take over",
        "COM_RCL_EXCEPT = 0 # a lost radio ends OFFBOARD, too",
        "NAV_RCL_ACT = 3",
        "COM_OF_LOSS_T = 0.5",
        "COM_OBL_RC_ACT = 4 # LAND when setpoints stop",
        "NAV_DLL_ACT = 0 # a ground station may leave",
        "COM_LOW_BAT_ACT = 2",
        "GF_ACTION = 2 # HOLD at its own fence",
    ),
    "ardupilot": (
        "FS_THR_ENABLE = 3 # lands when the radio is lost",
        "FS_OPTIONS = 16",
        "FENCE_OPTIONS = 0",
        "FENCE_ACTION = 4 # BRAKE at its own fence, or LAND",
        "FS_GCS_ENABLE = 5 # lands after the companion's last heartbeat",
        "FS_GCS_TIMEOUT = 2",
        "MAV_GCS_SYSID = 245",
        "RTL_ALT = 300",
    ),
}
"""As docs/field.md explains them."""
CAMERAS = {
    "realsense": (
        'factory = "drivers.realsense.camera:RealSense"',
        "fps = 30",
        '# serial = "..." # where a computer has two of them',
    ),
}


def write_rig(
    asked: str,
    autopilot: str,
    camera: str,
    out: TextIO,
) -> None:
    """Write the rig and, unless there is one already, its key. Raises PartError, OSError."""
    path = Path(asked if asked.endswith(".toml") else f"{asked}.toml")
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]*", path.stem):
        raise PartError(
            f"--new {asked}: {path.stem!r} is no name for a rig", "use letters, digits, '-' and '_'"
        )
    if (FOLDER / f"{path.stem}.toml").exists():
        # `--rig NAME` would be the other one.
        raise PartError(
            f"--new {asked}: a rig that comes with PATH is called {path.stem}",
            "choose another name",
        )
    if path.exists():
        raise PartError(f"{path} is there already", "name another file; nothing is written over")
    key = path.with_suffix(".key")
    text = files("missions.field").joinpath(TEMPLATE).read_text("utf-8")
    filled = {
        "NAME": path.stem,
        "AUTOPILOT": autopilot,
        "PARAMETERS": "\n".join(PARAMETERS[autopilot]),
        "CAMERA": "\n".join(CAMERAS[camera]),
        "KEY": key.name,
    }
    for name, value in filled.items():
        text = text.replace(f"@{name}@", value)
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
        _write_key(key)
    except OSError as error:
        raise PartError(
            f"{error.filename}: {error.strerror}", "name a file in a folder that can be written"
        ) from error
    out.write(
        f"{path}: the rig\n{key}: the key of its link; copy it to the other companion, and show it to nobody\n"
        f"next: fill in what says MEASURE, until `path-handoff rigs --check {path}` finds nothing\n"
    )


def _write_key(key: Path) -> None:
    """Readable by its owner alone from its first byte on."""
    try:
        descriptor = os.open(key, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError:
        return
    with os.fdopen(descriptor, "wb") as file:
        file.write(secrets.token_bytes(KEY_BYTES))
