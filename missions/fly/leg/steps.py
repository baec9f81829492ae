"""Steps that both roles fly alike: preflight, take-off, the way down."""

from __future__ import annotations

import asyncio
from collections import Counter
from dataclasses import replace
from functools import partial

from drivers.interfaces import (
    SURE,
    Capability,
    FlightMode,
    LinkCounters,
    TakenOver,
    VehicleError,
    VehicleState,
    lacking,
)
from drivers.mavlink.guard.interfaces import Script
from drivers.mavlink.preflight.geofence import Geofence
from flight.guard.limits import in_doubt
from flight.guard.under_guard import UnderGuard
from flight.guidance import Anchor, bearing, norm, subtract
from flight.keep_out import clear, level_m, place_to_land
from flight.outcome import MissionEnd, Outcome
from flight.phases import Phase
from flight.pilot import DOUBT_S
from missions.fly.leg.keyframes import check_depth
from missions.fly.leg.session import RoleSession
from path.alike import differing
from path.messages import Role

_FIRST_FRAME_S = 10.0
_SETTLED_M = 0.35
_SCRIPT_LET_GO = frozenset({Outcome.PILOT_OVERRIDE})
_DISARM_POLL_S = 0.1
_DISARM_S = 4.0  # PX4 and ArduCopter are disarmed 2 s after they call themselves on the ground
_POLL_S = 0.02
_TOLD_S = 3.0
_REPLAN_S = 0.25
_NO_MANOEUVRE = frozenset(
    {Outcome.VEHICLE_LOST, Outcome.VEHICLE_REFUSED, Outcome.GUARD, Outcome.CRASHED}
)


async def preflight(session: RoleSession) -> None:
    """Camera gives frames, vehicle is armable, the other drone is heard and its clock known.
    Nothing moves before.
    """
    await check_own(session)
    await hear_peer(session)


async def check_own(session: RoleSession) -> None:
    """Camera gives frames, vehicle is armable, and the guard watches it."""
    session.enter(Phase.PREFLIGHT)
    check_capabilities(session)
    deadlines = session.config.deadlines
    check_depth(session, await session.perception.view(_FIRST_FRAME_S))
    expect = getattr(session.vehicle, "expect_telemetry", None)
    if expect is not None:
        expect(session.config.guard.telemetry_age_s)
    await session.vehicle.wait_armable(deadlines.armable_s)
    await keep_geofence(session)
    guard = session.guarding.guard
    if guard is not None:
        what = "the guard's process did not answer and see the vehicle"
        await session.until(lambda: guard.watching, deadlines.guard_s, Outcome.GUARD_LOST, what)


async def keep_geofence(session: RoleSession) -> None:
    """Give the autopilot a fence of its own, one step wider than the script's, where it can have
    one. Raises VehicleError when it cannot be read back."""
    keep = getattr(session.vehicle, "keep_geofence", None)
    if keep is None or Capability.GEOFENCE in lacking(session.vehicle):
        return
    guard = session.config.guard
    written = await keep(Geofence(guard.fence_radius_m, guard.fence_height_m))
    if written:
        told = ", ".join(f"{name} {value:g}" for name, value in written.items())
        session.log.write("/geofence", session.now_ns(), {"set": dict(written)})
        session.say(f"the autopilot was given its fence: {told}")


async def hear_peer(session: RoleSession) -> None:
    """The other drone is heard, and its clock is known."""
    deadlines = session.config.deadlines
    await session.until(
        lambda: session.peer is not None,
        deadlines.peer_s,
        Outcome.PEER_LOST,
        lambda: _unheard(session.link.counters),
    )
    await check_alike(session)
    await session.until(
        lambda: _aligned(session),
        deadlines.peer_s,
        Outcome.CLOCK_FAULT,
        lambda: _unaligned(session),
    )


def _unheard(counters: LinkCounters) -> str:
    """Say that nobody was heard, and what came all the same: of another version of PATH no packet
    is understood.
    """
    dropped = Counter(counters.dropped)
    if not dropped:
        return "the other drone was not heard"
    came = ", ".join(f"{number} as {reason}" for reason, number in dropped.most_common(3))
    return f"the other drone was not heard (packets came and were dropped, {came}: another version of PATH, or key?)"


def _unaligned(session: RoleSession) -> str:
    """Say how well the clocks are known, and what would be needed."""
    if not session.alignment.samples:
        return "the clocks were not aligned: no ping was answered"
    return f"the clocks were not aligned: {session.clocks_known}"


def _aligned(session: RoleSession) -> bool:
    """Whether the other drone's clock is known. Raises MissionEnd when that drone has said that it
    does not fly.
    """
    if session.peer_left:
        raise MissionEnd(Outcome.PEER_ABORTED, f"the other drone does not fly: {session.peer_left}")
    return session.alignment.ready


async def check_alike(session: RoleSession) -> None:
    """Raise MissionEnd(RIGS_DIFFER) when the other drone has something otherwise that both must
    have alike.
    """
    peer = session.peer
    if session.peer_alike is None and peer is not None and Phase.VERIFY.reached(peer.phase):
        # drones that verify leave it out of their Status, and were alike before: this program is a
        # later one
        session.log.write("/alike", session.now_ns(), {"differing": ""})
        return
    found = differing(session.alike, session.peer_alike)
    session.log.write("/alike", session.now_ns(), {"differing": "; ".join(found)})
    if not found:
        return
    detail = f"the drones differ in {'; '.join(found)}: both must have the same rig file and the same version of PATH"
    session.say(detail)
    # the other drone hears meanwhile what this one has, and says the same
    await asyncio.sleep(_TOLD_S)
    raise MissionEnd(Outcome.RIGS_DIFFER, detail)


def check_capabilities(session: RoleSession) -> None:
    """Raise MissionEnd(UNFIT) when a part lacks what the course or the rig's ``needs`` ask of
    it.
    """
    needed = set(session.config.needs)
    if session.role is Role.SENDER:
        needed.add(Capability.RANGE)  # it has to say where the target is
    for name, part in (("vehicle", session.vehicle), ("perception", session.perception)):
        missing = sorted(each.value for each in needed & lacking(part))
        if missing:
            raise MissionEnd(
                Outcome.UNFIT, f"the {session.role.value}'s {name} has no {', '.join(missing)}"
            )


async def take_off(session: RoleSession, height_m: float) -> None:
    """Arm, climb, take control. Refusals end the mission: no motion command is sent twice."""
    session.enter(Phase.TAKE_OFF)
    session.guarding.set_script(Script.CLIMB)
    await session.guarding.confirm()
    await session.vehicle.arm()
    await session.guarding.confirm()
    await session.vehicle.take_off(height_m, session.config.deadlines.take_off_s)
    await session.guarding.confirm()
    await session.pilot.take_control()
    session.spawn(session.pilot.run())


async def bring_down(
    session: RoleSession,
    end: MissionEnd | None,
    way_out: Anchor,
) -> bool:
    """Leave the other drone's way, to ``way_out``, then land. Returns whether the vehicle is down.

    A way out that leads out of a site ends before its edge, and none ends above an obstacle.

    A pilot who took over keeps the vehicle; a vehicle that is lost or refuses is not flown any
    farther.
    """
    pilot = session.pilot
    guard = session.guarding.guard
    if end is not None and end.outcome in _SCRIPT_LET_GO and not (guard and guard.taken):
        return await _leave_to_pilot(session)
    if not (await _sure_state(session)).armed:
        pilot.let_go()
        return True
    if may_manoeuvre(session, end):
        session.enter(Phase.DEPART)
        end_s = asyncio.get_running_loop().time() + session.config.deadlines.depart_s
        await _depart(session, _inside(session, way_out), end_s)
        await _until_clear(session, end_s)
    pilot.let_go()
    if guard is not None and guard.taken:
        return await _leave_to_guard(session, guard)
    mode = (await _sure_state(session)).mode
    if mode is FlightMode.LAND and not pilot.override:
        return await _leave_landing(session)
    if mode is FlightMode.OTHER:
        pilot.override = pilot.override or f"mode is {mode.value}"
    if pilot.override:
        session.say("the pilot flies: the script does not land")
        return await _leave_to_pilot(session)
    return await _land(session)


def _inside(session: RoleSession, way_out: Anchor) -> Anchor:
    fence = session.fence
    if not fence.confines:
        return way_out
    return replace(way_out, position_n_m=fence.nearest(way_out.position_n_m, lowest_m=0.0))


async def _sure_state(session: RoleSession) -> VehicleState:
    """The vehicle's, once more than one message says that it is not armed, or in a pilot's mode; or
    it stays so.
    """
    loop = asyncio.get_running_loop()
    end_s = loop.time() + DOUBT_S
    while in_doubt(state := session.vehicle.state, state.mode) or _may_be_a_pilots(state):
        if loop.time() > end_s:
            break
        await asyncio.sleep(_POLL_S)
    return state


def _may_be_a_pilots(state: VehicleState) -> bool:
    return state.mode is FlightMode.OTHER and state.mode_told < SURE


def may_manoeuvre(session: RoleSession, end: MissionEnd | None) -> bool:
    """Return whether the vehicle is still the script's to fly somewhere, after the course ended
    this way.
    """
    barred = _NO_MANOEUVRE | _SCRIPT_LET_GO
    return session.pilot.in_control and (end is None or end.outcome not in barred)


async def _land(session: RoleSession) -> bool:
    session.enter(Phase.LAND)
    session.guarding.set_script(Script.LANDING)
    try:
        await session.vehicle.land(session.config.deadlines.land_s)
    except VehicleError as error:
        session.say(f"landing not confirmed: {error}")
        if isinstance(error, TakenOver):
            session.pilot.override = str(error)
            return await _leave_to_pilot(session)
        return False
    session.guarding.set_script(Script.IDLE)
    return True


async def _leave_to_pilot(session: RoleSession) -> bool:
    """Send nothing more; whether it is down already: a pilot may have landed it, or stopped the
    motors there.

    What stands on the ground is given the time that an autopilot takes to disarm: it may have gone
    over to another mode a moment before it says so.
    """
    session.pilot.let_go()
    session.guarding.set_script(Script.LET_GO)
    loop = asyncio.get_running_loop()
    end_s = loop.time() + _DISARM_S
    while (state := session.vehicle.state).armed and not state.in_air and loop.time() < end_s:  # noqa: ASYNC110 (as above)
        await asyncio.sleep(_DISARM_POLL_S)
    return not (state.armed or state.in_air)


async def _leave_to_guard(session: RoleSession, guard: UnderGuard) -> bool:
    """Send nothing more, and stay until the guard has brought the vehicle down; whether it has."""
    session.guarding.set_script(Script.LET_GO)
    session.enter(Phase.LAND, f"the guard has the vehicle: {guard.taken}")
    await _until_disarmed(session)
    return not session.vehicle.state.armed


async def _leave_landing(session: RoleSession) -> bool:
    """Send nothing to a vehicle that somebody lands already, and stay until it is down; whether it
    is.
    """
    session.guarding.set_script(Script.LET_GO)
    session.enter(Phase.LAND, "it is landing already, not by this script")
    await _until_disarmed(session)
    return not session.vehicle.state.armed


async def _until_disarmed(session: RoleSession) -> None:
    loop = asyncio.get_running_loop()
    end_s = loop.time() + session.config.deadlines.land_s
    while session.vehicle.state.armed and loop.time() < end_s:  # noqa: ASYNC110 (telemetry has no event)
        await asyncio.sleep(_DISARM_POLL_S)


async def _depart(session: RoleSession, way_out: Anchor, end_s: float) -> None:
    """Fly the way out under guard; when that fails, what follows (landing) is still right."""
    towards = session.fence.towards
    session.pilot.guidance = lambda state: way_out.hold(state, towards=towards)
    loop = asyncio.get_running_loop()
    while session.pilot.in_control and loop.time() < end_s:
        if norm(subtract(way_out.position_n_m, session.vehicle.state.position_n_m)) < _SETTLED_M:
            return
        await asyncio.sleep(0.05)


async def _until_clear(session: RoleSession, end_s: float) -> None:
    """Stay out of the reach of what is tracked until the landing is over before any of it can be
    there; in the end, land all the same, and say so.
    """
    config = session.config
    loop = asyncio.get_running_loop()
    while session.pilot.in_control:
        now_ns = session.now_ns()
        bodies = session.bodies()
        here = session.vehicle.state.position_n_m
        room_m = clear(here, bodies, config, now_ns)
        if room_m >= 0.0:
            return
        if loop.time() >= end_s:
            short = f"{-room_m:.1f} m short of clear of what it tracks"
            session.say(f"lands {short}: no better place within {config.deadlines.depart_s:.0f} s")
            return
        other = session.here(session.peer).position_n_m if session.peer else None
        there = place_to_land(here, bodies, other, config, now_ns)
        nearest = min(bodies, key=lambda body: level_m(here, body.place_n_m))
        yaw_rad = bearing(subtract(nearest.place_n_m, here))
        aside = Anchor(there, yaw_rad)
        session.pilot.guidance = partial(
            aside.hold, max_speed_mps=config.follow.max_speed_mps, towards=session.fence.towards
        )
        await asyncio.sleep(_REPLAN_S)
