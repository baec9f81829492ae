"""The part of ``doctor`` that talks to a vehicle: are its parameters as the rig wants them? Sets them when told to."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Iterator, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any, Protocol

from drivers.interfaces import PartError, VehicleError
from drivers.rig import Rig, create, part_context
from missions.findings import Finding
from path.messages import Role

SET = "run doctor again with --set-parameters, or set it from its ground station"


class Difference(Protocol):
    """One parameter that is not as wanted; its text says all."""

    @property
    def name(self) -> str: ...

    @property
    def wanted(self) -> float: ...

    @property
    def found(self) -> float | None: ...


def check_vehicle(rig: Rig, role: Role, set_parameters: bool, folder: Path) -> Iterator[Finding]:
    """Connect, compare, set, record in ``folder``. Nothing moves."""
    try:
        yield from asyncio.run(_check(rig, role, set_parameters, folder))
    except PartError as error:
        yield Finding("fault", role.value, str(error), error.remedy)


async def _check(rig: Rig, role: Role, set_parameters: bool, folder: Path) -> list[Finding]:
    vehicle: Any = create(rig.role(role).vehicle, part_context(rig, role))
    if not hasattr(vehicle, "parameter_differences"):
        return [Finding("ok", role.value, "this vehicle has no parameters to compare")]
    async with vehicle:
        wrong: Sequence[Difference] = await vehicle.parameter_differences()
        if not wrong:
            return [Finding("ok", role.value, "parameters are as the rig wants them")]
        if not set_parameters:
            return [Finding("fault", role.value, str(each), SET) for each in wrong]
        if vehicle.state.armed:
            raise VehicleError("the vehicle is armed: no parameter was set", "disarm it first")
        changed: list[Difference] = []
        try:
            for each in wrong:
                await vehicle.set_parameter(each)
                changed.append(each)
        finally:
            record = _record(folder, rig, role, changed)
    done = [Finding("note", role.value, f"set: {each}") for each in wrong]
    return [*done, Finding("ok", role.value, f"what was set is recorded in {record}")]


def _record(folder: Path, rig: Rig, role: Role, changed: Sequence[Difference]) -> Path | None:
    """What each parameter was and is now, so that it can be undone."""
    if not changed:
        return None
    folder.mkdir(parents=True, exist_ok=True)
    now = datetime.now()
    file = folder / f"{now:%Y%m%d-%H%M%S}-{role.value}.json"
    record = {
        "rig": rig.name,
        "role": role.value,
        "time": now.isoformat(timespec="seconds"),
        "parameters": [{"name": each.name, "before": each.found, "after": each.wanted} for each in changed],
    }
    file.write_text(json.dumps(record, indent=2) + "\n", "utf-8")
    return file
