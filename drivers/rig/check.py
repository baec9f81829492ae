"""The checks of a rig before anything moves, without touching hardware."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from drivers.interfaces import LinkError
from drivers.rig.calibration_file import CalibrationError, check_serial
from drivers.rig.parts import SHARED_WITH_THE_VEHICLE, PartSpec, Rig, decode_part, import_factory
from drivers.rig.tables import Problems, RigError
from path.messages import Role

EXCLUSIVE = ("url", "bind", "sysid", "interface", "device", "serial")
"""Options of a part that name something only one part of a rig may use."""
OF_ROLE = ("host", "state_port", "video_port", "interface", "serial", "namespace")
"""Options that all parts of one role may share, when they mean the same drone, and nothing of the
other role.
"""


def check_rig(rig: Rig, *, harness: bool = True) -> None:
    """Check all that can be checked without touching hardware. Raises RigError with every problem
    found.

    Factories import and take their options, files that are named exist, keys are such, no two parts share a port,
    system id, interface or device, cameras are those that their calibrations are of, the two links
    point at each other, and the harness (its ``check_rig(rig)``, when it has one) agrees, if it is
    asked.
    """
    problems = Problems()
    configs = _decode_parts(rig, problems)
    _check_exclusive(configs, problems)
    _check_serials(rig, configs, problems)
    _check_guards(rig, configs, problems)
    if rig.harness is None:
        _check_mirrored(rig, configs, problems)
    elif harness:
        _check_harness(rig, rig.harness, problems)
    problems.raise_any()


def check_ready(rig: Rig) -> None:
    """Check what parts need besides their options, such as a model's file. Raises PartError, or
    RigError.
    """
    for config in _decode_parts(rig, Problems()).values():
        if hasattr(config, "check_ready"):
            config.check_ready()


def local_ports(rig: Rig) -> dict[int, str]:
    """The UDP ports that the rig's parts listen on, each with the option that names it."""
    ports: dict[int, str] = {}
    for where, config in _decode_parts(rig, Problems()).items():
        for name, value in _exclusive(config):
            kind, resource = _resource(name, value)
            if kind == "port" and resource.isdigit():
                ports[int(resource)] = f"{where.partition(': ')[2]}.{name}"
    return ports


def _decode_parts(rig: Rig, problems: Problems) -> dict[str, Any]:
    """Config of every part by where it is written, inner parts included."""
    configs: dict[str, Any] = {}
    for role in Role:
        for spec in rig.role(role).parts:
            _check_part(spec, configs, problems)
    if rig.reference is not None and rig.reference.beacons is not None:
        _check_part(rig.reference.beacons, configs, problems)
    return configs


def _exclusive(config: Any) -> list[tuple[str, Any]]:
    """The options of a part that occupy something. In a network namespace of its own a role has its
    own ports.
    """
    apart = bool(getattr(config, "namespace", ""))
    named = [
        (f.name, getattr(config, f.name))
        for f in dataclasses.fields(config)
        if f.name in (*EXCLUSIVE, *OF_ROLE)
    ]
    taken = [(name, value) for name, value in named if value not in (None, "")]
    return [
        (name, value)
        for name, value in taken
        if not (apart and name in ("host", "state_port", "video_port"))
    ]


def _check_part(
    spec: PartSpec,
    configs: dict[str, Any],
    problems: Problems,
) -> None:
    try:
        _, config = decode_part(spec)
    except RigError as error:
        problems.absorb(error)
        return
    configs[spec.where] = config
    for name in (f.name for f in dataclasses.fields(config)):
        value = getattr(config, name)
        if isinstance(value, PartSpec):
            _check_part(value, configs, problems)
        elif isinstance(value, Path) and not value.exists():
            problems.add(f"{spec.where}.{name}", f"{value}: no such file")
        elif isinstance(value, Path) and name == "key_file":
            _check_key(value, f"{spec.where}.{name}", problems)


def _check_key(
    file: Path,
    where: str,
    problems: Problems,
) -> None:
    from drivers.link.key import read_key  # noqa: PLC0415 (most rigs have no key, and need no dialect)

    try:
        read_key(file)
    except LinkError as error:
        problems.add(where, f"{error}: {error.remedy}")


def _check_exclusive(configs: Mapping[str, Any], problems: Problems) -> None:
    used: dict[tuple[str, str], str] = {}
    for where, config in configs.items():
        role = where.partition(": ")[2].partition(".")[0]
        for name, value in _exclusive(config):
            key = _resource(name, value)
            one_drone = hasattr(config, "host") and name in OF_ROLE
            if key in used and one_drone and used[key].partition(".")[0] == role:
                continue  # vehicle and camera of one drone
            if key in used:
                problems.add(
                    f"{where}.{name}",
                    f"{value!r} is already used by {used[key]}; each needs its own",
                )
            used.setdefault(key, f"{where.partition(': ')[2]}.{name}")


def _check_serials(
    rig: Rig,
    configs: Mapping[str, Any],
    problems: Problems,
) -> None:
    """A camera whose serial number is written must be the one its calibration is of."""
    for role in Role:
        own = rig.role(role)
        for where, config in configs.items():
            serial = getattr(config, "serial", "") if where.startswith(own.perception.where) else ""
            try:
                check_serial(
                    own.camera_serial,
                    str(serial or ""),
                    rig.where(f"{role.value}.camera"),
                )
            except CalibrationError as error:
                problems.add(f"{where}.serial", str(error))


def _resource(name: str, value: Any) -> tuple[str, str]:
    """Return what an option occupies. Two listeners on one UDP port collide whatever their
    addresses say.
    """
    text = str(value)
    if name in ("state_port", "video_port"):
        return "port", text
    local = name == "bind" or text.startswith(("udpin://", "tcpin://"))
    if name in ("url", "bind") and local:
        return "port", text.rpartition(":")[2]
    return ("device" if name in ("device", "url") else name), text


def _check_guards(
    rig: Rig,
    configs: Mapping[str, Any],
    problems: Problems,
) -> None:
    """A guard that watches another vehicle than the one that is flown guards nothing."""
    for role in Role:
        own = rig.role(role)
        watched = (
            getattr(configs.get(own.guard.where), "vehicle_sysid", None) if own.guard else None
        )
        flown = getattr(configs.get(own.vehicle.where), "sysid", None)
        if own.guard and watched is not None and flown is not None and watched != flown:
            problems.add(
                f"{own.guard.where}.vehicle_sysid",
                f"{watched} is not the vehicle that is flown, {flown}",
            )
        for name in SHARED_WITH_THE_VEHICLE:
            theirs = own.vehicle.options.get(name)
            if own.guard and own.guard.options.get(name, theirs) != theirs:
                problems.add(
                    f"{own.guard.where}.{name}", f"not the vehicle's, {theirs!r}: leave it out"
                )


def _check_mirrored(
    rig: Rig,
    configs: Mapping[str, Any],
    problems: Problems,
) -> None:
    ends = [configs.get(rig.role(role).link.where) for role in Role]
    if not all(hasattr(end, "bind") and hasattr(end, "peer") for end in ends):
        return
    for own, other, role in ((ends[0], ends[1], "sender"), (ends[1], ends[0], "receiver")):
        peer, bind = str(getattr(own, "peer")), str(getattr(other, "bind"))  # noqa: B009 (Config of any link)
        same_host = bind.rpartition(":")[0] in ("0.0.0.0", "", peer.rpartition(":")[0])
        if peer.rpartition(":")[2] != bind.rpartition(":")[2] or not same_host:
            problems.add(
                rig.where(f"{role}.link.peer"),
                f"{peer!r} is not where the other drone listens: {bind!r}",
            )


def _check_harness(
    rig: Rig,
    harness: str,
    problems: Problems,
) -> None:
    try:
        kind = import_factory(harness, rig.where("harness"))
        if hasattr(kind, "check_rig"):
            kind.check_rig(rig)
    except RigError as error:
        problems.absorb(error)
