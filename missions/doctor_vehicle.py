"""The part of ``doctor`` that talks to a vehicle: what it tells for two seconds, and its parameters. Nothing moves."""

from __future__ import annotations

import asyncio
import json
import math
from collections.abc import AsyncIterator, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, Protocol

from drivers.interfaces import PartError, Vehicle, VehicleError, VehicleState
from drivers.part_check import Finding, examined, rate_of
from drivers.rig import Rig, create, part_context
from path.messages import Role

SET = "run doctor again with --vehicle ROLE --set-parameters, or set it from its ground station"
SAMPLE_S, POLL_S, READY_S = 2.0, 0.005, 5.0
SLOW, MUCH_TOO_SLOW = 0.9, 0.5  # of the telemetry that the rig asks for
SLOWEST_HEARTBEAT_S = 1.5


class Difference(Protocol):
    """One parameter that is not as wanted; its text says all."""

    @property
    def name(self) -> str: ...

    @property
    def wanted(self) -> float: ...

    @property
    def found(self) -> float | None: ...


@dataclass(frozen=True, slots=True)
class Heard:
    """Instants (ns, role clock) of a vehicle's telemetry and heartbeats while it was listened to."""

    telemetry_ns: tuple[int, ...]
    heartbeats_ns: tuple[int, ...]
    seconds: float


async def check_flyer(vehicle: Vehicle, min_battery: float) -> AsyncIterator[Finding]:
    """Open, listen, compare parameters, close. Nothing is armed, set or moved. Raises VehicleError.

    Args:
        min_battery: at which the mission ends, as a share.
    """
    async with vehicle:
        yield Finding("ok", "connects", "heartbeat and attitude came")
        heard = await _heard(vehicle)
        for finding in streams(heard, rate_of(vehicle)):
            yield finding
        for own in await examined(vehicle):
            yield own
        state = await _ready(vehicle)
        for finding in condition(state, min_battery):
            yield finding
        if hasattr(vehicle, "parameter_differences"):
            for finding in await _parameters(vehicle):
                yield finding


async def _heard(vehicle: Vehicle) -> Heard:
    loop = asyncio.get_running_loop()
    telemetry: dict[int, None] = {}
    heartbeats: dict[int, None] = {}
    start_s = loop.time()
    while loop.time() - start_s < SAMPLE_S:
        state = vehicle.state
        telemetry[state.stamp_ns] = heartbeats[state.heartbeat_ns] = None
        await asyncio.sleep(POLL_S)
    return Heard(tuple(telemetry), tuple(heartbeats), loop.time() - start_s)


async def _ready(vehicle: Vehicle) -> VehicleState:
    """Its state once it can be armed, or after READY_S."""
    loop = asyncio.get_running_loop()
    end_s = loop.time() + READY_S
    while not (state := vehicle.state).armable and loop.time() < end_s:  # noqa: ASYNC110 (state is read)
        await asyncio.sleep(POLL_S)
    return state


def streams(heard: Heard, wanted_hz: float | None) -> Iterator[Finding]:
    """How often it tells where it is, and that it lives."""
    found_hz = (len(heard.telemetry_ns) - 1) / heard.seconds
    fix = "a faster link (baud, radio), or a lower telemetry_hz in the rig"
    if heard.telemetry_ns == (0,):
        yield Finding("fault", "telemetry", "attitude, but no position", "see what its ground station says of its GPS")
    elif wanted_hz is None or found_hz >= SLOW * wanted_hz:
        yield Finding("ok", "telemetry", _of(found_hz, wanted_hz))
    else:
        state = "fault" if found_hz < MUCH_TOO_SLOW * wanted_hz else "note"
        yield Finding(state, "telemetry", _of(found_hz, wanted_hz), fix)
    beats = len(heard.heartbeats_ns)
    detail = f"{beats} in {heard.seconds:.1f} s"
    if beats < heard.seconds / SLOWEST_HEARTBEAT_S:
        yield Finding("fault", "heartbeat", detail, "check cable or radio")
    else:
        yield Finding("ok", "heartbeat", detail)


def condition(state: VehicleState, min_battery: float) -> Iterator[Finding]:
    """Whether a mission could begin with it as it is."""
    if state.armed or state.in_air:
        yield Finding("fault", "armed", "it is armed", "land it, disarm it, and look again")
    else:
        yield Finding("ok", "armed", "it is disarmed")
    detail = f"{100.0 * state.battery:.0f} %, the mission ends at {100.0 * min_battery:.0f} %"
    enough = state.battery > min_battery and math.isfinite(state.battery)
    yield Finding("ok" if enough else "fault", "battery", detail, "" if enough else "charge or change it")
    if state.armable:
        yield Finding("ok", "ready to arm", "yes")
    else:
        fix = "give it a clear sky and do what its ground station shows"
        yield Finding("fault", "ready to arm", f"not within {READY_S:g} s", fix)


def _of(found_hz: float, wanted_hz: float | None) -> str:
    return f"{found_hz:.1f} a second" if wanted_hz is None else f"{found_hz:.1f} of {wanted_hz:g} a second"


async def _parameters(vehicle: Any) -> list[Finding]:
    wrong: Sequence[Difference] = await vehicle.parameter_differences()
    if not wrong:
        return [Finding("ok", "parameters", "are as the rig wants them")]
    return [Finding("fault", "parameters", str(each), SET) for each in wrong]


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
