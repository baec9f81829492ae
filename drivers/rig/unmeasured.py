"""A rig of which not everything is measured yet, for the commands that measure it.

A new rig names the calibrations that are still to be made, and says MEASURE where a number is
missing. Who calibrates a camera needs that camera's part of the rig and nothing else: the rest is
filled with stand-ins, none of which may reach a result.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from drivers.rig.file import rig_of
from drivers.rig.parts import Rig
from drivers.rig.read import find_rig, read_rig
from path.messages import Role

UNMEASURED = "MEASURE"
_ORIGIN = {"latitude_deg": 0.0, "longitude_deg": 0.0, "altitude_m": 0.0}
_MARKERS = [{"id": 0, "side_m": 0.04}]
_MARKER_PLACE = {"position_b_m": [0.0, 0.0, 0.0], "tilt_up_deg": 0.0}
_UNUSED = (
    "mission",
    "world",
    "trials",
    "reference",
    "relay",
    "team",
    "drones",
    "targets",
    "harness",
    "target",
    "drone",
    "site",
    "depth",
    "link",
    "height",
    "detector",
)
"""Tables that have nothing to do with a camera or where it sits."""


def load_for_camera(
    name_or_path: str | Path,
    search: Sequence[Path],
    size: tuple[int, int],
) -> Rig:
    """Load a rig for the calibration of one of its cameras.

    Args:
        name_or_path: as of ``load_rig``, as is ``search``.
        size: width and height of the stream in px of a camera whose calibration is not there yet.

    Raises:
        RigError: for what is wrong in what is left of it.
    """
    path = find_rig(name_or_path, search)
    table = _needed(read_rig(path, search))
    for role in Role:
        drone = _table(table, role.value)
        if _is_to_be_made(drone.get("camera"), path.parent):
            drone["camera"] = _camera(*size)
        mount = _table(drone, "mount")
        mount["camera"] = _numbered(mount.get("camera"))
        if role is Role.SENDER:
            mount["marker"] = _MARKER_PLACE
    table["markers"] = _MARKERS
    table.pop("marker_dictionary", None)
    table.pop("method", None)
    return rig_of(table, path, search)


def load_for_mount(name_or_path: str | Path, search: Sequence[Path]) -> tuple[Rig, bool]:
    """Load a rig to calibrate its marker's mount; also whether it says how the marker hangs. Raises
    RigError.
    """
    path = find_rig(name_or_path, search)
    table = _needed(read_rig(path, search))
    receiver = _table(table, "receiver")
    if _is_to_be_made(receiver.get("camera"), path.parent):
        receiver["camera"] = _camera(16, 16)
    for role in Role:
        mount = _table(_table(table, role.value), "mount")
        mount["camera"] = _numbered(mount.get("camera"))
    mount = _table(_table(table, "sender"), "mount")
    hangs = not _is_to_be_made(mount.get("marker"), path.parent)
    mount["marker"] = _numbered(mount.get("marker")) if hangs else _MARKER_PLACE
    return rig_of(table, path, search), hangs


def _needed(table: Mapping[str, Any]) -> dict[str, Any]:
    made = {key: value for key, value in table.items() if key not in _UNUSED}
    made["origin"] = _ORIGIN
    return made


def _table(table: dict[str, Any], key: str) -> dict[str, Any]:
    """Return a table in a table as one that may be changed; what is no table stays, and is refused
    later.
    """
    inner = table.get(key)
    if not isinstance(inner, dict):
        return {}
    table[key] = dict(inner)
    return table[key]


def _is_to_be_made(table: object, folder: Path) -> bool:
    name = table.get("calibration") if isinstance(table, Mapping) else None
    return isinstance(name, str) and not (folder / name).exists()


def _camera(width: int, height: int) -> dict[str, Any]:
    return {
        "width": width, "height": height, "fx": float(width), "fy": float(width), "cx": width / 2.0, "cy": height / 2.0,
        "distortion": [0.0] * 5,
    }  # fmt: skip


def _numbered(table: object) -> object:
    """Zeros for numbers that are not measured yet."""
    if isinstance(table, Mapping):
        return {key: _numbered(value) for key, value in table.items()}
    if isinstance(table, list):
        return [_numbered(value) for value in table]
    return 0.0 if table == UNMEASURED else table
