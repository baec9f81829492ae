"""The room for logs and shared memory on this computer, against what a rig records."""

from __future__ import annotations

import shutil
from pathlib import Path

from drivers.rig.part_check import Finding
from drivers.rig.parts import Rig, RoleRig
from drivers.rig.tables import RigError
from missions.ground import rig_library

SHM_MIB = 64
DISK_MIB = 500
MINUTES = 10.0  # of recorded flight that there should be room for
COLOR_BITS_PER_PX = 0.2  # H.264 of rendered scenes; noise and texture take more
DEPTH_BYTES_PER_PX = 1.4  # of two, with the noise of a D415
USUAL_HZ = 30.0


def check_room(name: str) -> Finding:
    disk = shutil.disk_usage(_existing(Path("runs").resolve())).free >> 20
    shared = shutil.disk_usage("/dev/shm").free >> 20 if Path("/dev/shm").is_dir() else 0
    detail = f"{disk} MiB for logs, {shared} MiB shared memory for frames"
    rate = mb_a_minute(name)
    if rate:
        detail += f"; record = all: about {rate:.0f} MB a minute and drone"
    if disk < DISK_MIB:
        return Finding(
            "fault",
            "room",
            detail,
            f"free {DISK_MIB} MiB here, or name another folder with --out",
        )
    if disk < 2.0 * rate * MINUTES:
        return Finding(
            "note",
            "room",
            detail,
            f"that is room for {disk / (2.0 * rate):.0f} minutes of two drones",
        )
    if shared < SHM_MIB:
        return Finding("note", "room", detail, f"rigs of level sitl need {SHM_MIB} MiB in /dev/shm")
    return Finding("ok", "room", detail)


def mb_a_minute(name: str) -> float:
    """Megabytes of frames that a drone of a rig records a minute, the one that records more; 0 when
    none are.
    """
    try:
        rig = rig_library.load(name)
        return max(map(_recorded, (rig.sender, rig.receiver))) if _records(rig) else 0.0
    except RigError:  # which is said elsewhere
        return 0.0


def _records(rig: Rig) -> bool:
    return rig_library.mission_of(rig).record == "all"


def _recorded(own: RoleRig) -> float:
    """MB a minute."""
    camera = own.perception.options.get("camera", {})
    hz = next((float(camera[key]) for key in ("fps", "rate_hz") if key in camera), USUAL_HZ)
    pixels = own.camera.width * own.camera.height
    return pixels * hz * 60.0 * (COLOR_BITS_PER_PX / 8.0 + DEPTH_BYTES_PER_PX) * 1e-6


def _existing(folder: Path) -> Path:
    return next(path for path in (folder, *folder.parents) if path.exists())
