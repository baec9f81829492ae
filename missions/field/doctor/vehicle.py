"""The part of ``doctor`` that talks to a vehicle: what it tells for two seconds, and its
parameters. Nothing moves.
"""

from __future__ import annotations

import asyncio
import json
import math
from collections.abc import AsyncIterator, Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

from drivers.interfaces import Clock, PartError, Vehicle, VehicleError, VehicleState
from drivers.mavlink.preflight.geofence import FencePlan, Geofence
from drivers.mavlink.preflight.parameters import Difference
from drivers.rig.facts import HeightFacts
from drivers.rig.part_check import Finding, examined
from drivers.rig.parts import Rig, create, part_context
from flight.config import MissionConfig
from missions.ground.rig_library import mission_of
from path.messages import Role
from path.values import frozen

SET = "run doctor again with --vehicle ROLE --set-parameters, or set it from its ground station"
SAMPLE_S = 2.0
POLL_S = 0.005
READY_S = 5.0
RANGEFINDER_S = 2.0
# telemetry: the mission's own guard lands the vehicle when it is older (telemetry_age_s)
OLD_S = 0.5
SLOWEST_HEARTBEAT_S = 1.5


@frozen
class VehicleReport:
    """The messages of a vehicle while it was listened to.

    Attributes:
        oldest_s: age of its newest telemetry at its worst; None when it never said where it is.
        heartbeats: how many came.
    """

    oldest_s: float | None
    heartbeats: int
    seconds: float


async def check_flyer(
    vehicle: Vehicle,
    clock: Clock,
    min_battery: float,
    fence: Geofence | None = None,
    height: HeightFacts | None = None,
) -> AsyncIterator[Finding]:
    """Open, listen, compare parameters, close. Nothing is armed, set or moved. Raises VehicleError.

    Args:
        min_battery: at which the mission ends, as a share.
        fence: the script's, one step outside of which the autopilot's own has to be.
        height: what the rig says of a rangefinder.
    """
    async with vehicle:
        yield Finding("ok", "connects", "heartbeat and attitude came")
        heard = await _heard(vehicle, clock)
        for finding in streams(heard):
            yield finding
        for own in await examined(vehicle):
            yield own
        state = await _ready(vehicle)
        for finding in condition(state, min_battery):
            yield finding
        for finding in await _rangefinder(vehicle, height):
            yield finding
        if hasattr(vehicle, "parameter_differences"):
            for finding in await _parameters(vehicle):
                yield finding
        if hasattr(vehicle, "pilot_findings"):
            for finding in await _pilot_and_fence(vehicle, fence):
                yield finding


async def _heard(vehicle: Vehicle, clock: Clock) -> VehicleReport:
    loop = asyncio.get_running_loop()
    ages_s: list[float] = []
    heartbeats: set[int] = set()
    start_s = loop.time()
    while (seconds := loop.time() - start_s) < SAMPLE_S:
        state = vehicle.state
        heartbeats.add(state.heartbeat_ns)
        if state.stamp_ns:
            ages_s.append((clock.now_ns() - state.stamp_ns) * 1e-9)
        await asyncio.sleep(POLL_S)
    return VehicleReport(max(ages_s, default=None), len(heartbeats), seconds)


async def _ready(vehicle: Vehicle) -> VehicleState:
    """Its state once it can be armed, or after READY_S."""
    loop = asyncio.get_running_loop()
    end_s = loop.time() + READY_S
    while not (state := vehicle.state).armable and loop.time() < end_s:  # noqa: ASYNC110 (state is read)
        await asyncio.sleep(POLL_S)
    return state


def streams(heard: VehicleReport) -> Iterator[Finding]:
    """Find whether it tells where it is, and that it lives."""
    fix = "check cable or radio"
    if heard.oldest_s is None:
        yield Finding(
            "fault",
            "telemetry",
            "attitude, but no position",
            "see what its ground station says of its GPS",
        )
    else:
        detail = f"never older than {1e3 * heard.oldest_s:.0f} ms"
        late = heard.oldest_s > OLD_S
        yield (
            Finding("fault", "telemetry", detail, fix)
            if late
            else Finding("ok", "telemetry", detail)
        )
    detail = f"{heard.heartbeats} in {heard.seconds:.1f} s"
    if heard.heartbeats < heard.seconds / SLOWEST_HEARTBEAT_S:
        yield Finding("fault", "heartbeat", detail, fix)
    else:
        yield Finding("ok", "heartbeat", detail)


def condition(state: VehicleState, min_battery: float) -> Iterator[Finding]:
    """Find whether a mission could begin with it as it is."""
    if state.armed or state.in_air:
        yield Finding("fault", "armed", "it is armed", "land it, disarm it, and look again")
    else:
        yield Finding("ok", "armed", "it is disarmed")
    yield _charge(state.battery, min_battery)
    if state.armable:
        yield Finding("ok", "ready to arm", "yes")
    else:
        fix = "give it a clear sky and do what its ground station shows"
        yield Finding("fault", "ready to arm", f"not within {READY_S:g} s", fix)


async def _rangefinder(vehicle: Any, height: HeightFacts | None) -> list[Finding]:
    """Find whether the rangefinder that the rig counts on is heard. On the ground it may be too
    near to measure.
    """
    if height is None or not height.has_rangefinder:
        return []
    if not hasattr(vehicle, "rangefinder"):
        return [Finding("note", "rangefinder", "this vehicle's driver has no such test")]
    wrong, said = await vehicle.rangefinder(RANGEFINDER_S)
    if wrong:
        fix = "see that the autopilot sends it (ArduPilot: RNGFND1_TYPE and RNGFND1_ORIENT 25; PX4: its driver)"
        return [
            Finding(
                "fault",
                "rangefinder",
                wrong,
                f"{fix}, or leave rangefinder_max_m out of [height]",
            )
        ]
    return [Finding("ok", "rangefinder", said)]


def _charge(level: float, min_battery: float) -> Finding:
    if not math.isfinite(level):
        fix = "set its capacity (PX4: BAT1_CAPACITY, ArduPilot: BATT_CAPACITY), or battery_id in the vehicle's table"
        return Finding(
            "fault",
            "battery",
            "the vehicle tells no percentage of the battery that flies it",
            fix,
        )
    detail = f"{100.0 * level:.0f} %, the mission ends at {100.0 * min_battery:.0f} %"
    if level > min_battery:
        return Finding("ok", "battery", detail)
    return Finding("fault", "battery", detail, "charge or change it")


async def _parameters(vehicle: Any) -> list[Finding]:
    wrong: Sequence[Difference] = await vehicle.parameter_differences()
    if not wrong:
        return [Finding("ok", "parameters", "are as the rig wants them")]
    return [Finding("fault", "parameters", str(each), SET) for each in wrong]


async def _pilot_and_fence(vehicle: Any, fence: Geofence | None) -> list[Finding]:
    found: list[Finding] = list(await vehicle.pilot_findings())
    if fence is None:
        return found
    plan: FencePlan = await vehicle.plan_geofence(fence)
    fix = "correct what is named: the autopilot's fence is what is left when script and guard are gone"
    found += [Finding("fault", "fence", problem, fix) for problem in plan.problems]
    if plan.set_to:
        told = ", ".join(f"{name} {value:g}" for name, value in plan.set_to.items())
        found.append(
            Finding("note", "fence", f"a flight will set {told}", "or set it now: --set-parameters")
        )
    elif not plan.problems:
        found.append(Finding("ok", "fence", "its own is there, wider than the script's"))
    return found


def check_vehicle(
    rig: Rig,
    role: Role,
    set_parameters: bool,
    folder: Path,
) -> Iterator[Finding]:
    """Connect, compare, set, record in ``folder``. Nothing moves."""
    try:
        yield from asyncio.run(_check(rig, role, set_parameters, folder))
    except PartError as error:
        yield Finding("fault", role.value, str(error), error.remedy)


async def _check(
    rig: Rig,
    role: Role,
    set_parameters: bool,
    folder: Path,
) -> list[Finding]:
    vehicle: Any = create(rig.role(role).vehicle, part_context(rig, role))
    if not hasattr(vehicle, "parameter_differences"):
        return [Finding("ok", role.value, "this vehicle has no parameters to compare")]
    async with vehicle:
        wrong: list[Difference] = list(await vehicle.parameter_differences())
        besides = [
            replace(each, name=f"{role.value} {each.name}")
            for each in await _pilot_and_fence(vehicle, None)
        ]
        if set_parameters:
            wrong += await _missing_fence(vehicle, fence_of(mission_of(rig)))
        if not wrong:
            return [Finding("ok", role.value, "parameters are as the rig wants them"), *besides]
        if not set_parameters:
            return [*(Finding("fault", role.value, str(each), SET) for each in wrong), *besides]
        if vehicle.state.armed:
            raise VehicleError("the vehicle is armed: no parameter was set", "disarm it first")
        changed: list[Difference] = []
        try:
            for each in wrong:
                await vehicle.set_parameter(each)
                changed.append(each)
        finally:
            record = _record(folder, rig, role, changed)
        besides = [
            replace(each, name=f"{role.value} {each.name}")
            for each in await _pilot_and_fence(vehicle, None)
        ]
    done = [Finding("note", role.value, f"set: {each}") for each in wrong]
    return [*done, *besides, Finding("ok", role.value, f"what was set is recorded in {record}")]


def fence_of(config: MissionConfig) -> Geofence:
    """The script's fence."""
    return Geofence(config.guard.fence_radius_m, config.guard.fence_height_m)


async def _missing_fence(vehicle: Any, fence: Geofence) -> list[Difference]:
    plan: FencePlan = await vehicle.plan_geofence(fence)
    if plan.problems:
        raise VehicleError("; ".join(plan.problems), "correct what is named")
    before: Mapping[str, float | None] = await vehicle.read_parameters(plan.set_to)
    return [Difference(name, value, before.get(name)) for name, value in plan.set_to.items()]


def _record(
    folder: Path,
    rig: Rig,
    role: Role,
    changed: Sequence[Difference],
) -> Path | None:
    """Records what each parameter was and is now, so that it can be undone."""
    if not changed:
        return None
    folder.mkdir(parents=True, exist_ok=True)
    now = datetime.now()
    file = folder / f"{now:%Y%m%d-%H%M%S-%f}-{role.value}.json"
    record = {
        "rig": rig.name,
        "role": role.value,
        "time": now.isoformat(timespec="seconds"),
        "parameters": [
            {"name": each.name, "before": each.found, "after": each.wanted} for each in changed
        ],
    }
    with file.open("x", encoding="utf-8") as new:  # never over another
        new.write(json.dumps(record, indent=2) + "\n")
    return file
