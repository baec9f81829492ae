"""The flights of the suite: each leaves the vehicle on the ground, and gives figures by the names
of ``rows``.
"""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable

import numpy as np

from drivers.interfaces import FlightMode, VehicleError, VelocitySetpoint
from missions.proofs.conformance.stage import ARM, FORCE, SET_MODE, TAKE_OFF, FlightStage, Values
from missions.proofs.conformance.track import (
    AIRBORNE_M,
    FlightTrack,
    estimate_errors,
    fastest_mps,
    first,
    in_words,
    landed_since,
    longest_gap_s,
    modes_since,
    rate_hz,
    response,
    standing,
    when,
)
from path.values import frozen

HEIGHT_M = 3.0
HOLD_S = 8.0
STEP_MPS = 1.0
STEP_S = 4.0
IDLE_S = 30.0
STREAMS = {
    "heartbeat_hz": 0,
    "attitude_hz": 31,
    "local_position_hz": 32,
    "global_position_hz": 33,
    "landed_state_hz": 245,
}


async def on_the_ground(stage: FlightStage) -> Values:
    """Answer to what makes no sense, and how long it waits armed."""
    await stage.ready()
    found: Values = {
        "unknown_command": await stage.order(31999),
        "unknown_mode": await stage.order(SET_MODE, 1.0, 99.0, 0.0),
        "take_off_disarmed": await stage.order_take_off(HEIGHT_M),
    }
    await stage.vehicle.hold()
    begun_s = stage.now_s
    await stage.vehicle.arm()
    acknowledged = stage.answer(ARM, begun_s)
    shown_s = next(
        (each.time_s for each in stage.heard.shown if each.armed and each.time_s > begun_s),
        math.nan,
    )
    found["arm_s"] = stage.now_s - begun_s
    found["arm_shown_s"] = None if acknowledged is None else shown_s - acknowledged.time_s
    found["arm_again"] = await stage.order(ARM, 1.0)
    await stage.until(lambda: not stage.armed, IDLE_S)
    found["idle_disarm_s"] = when(modes_since(stage.heard.shown, shown_s), "disarmed")
    return found


async def course(stage: FlightStage) -> Values:
    """Take-off, hover, steps of speed and heading, another station's hold, landing."""
    found = await _take_off(stage)
    found |= await _in_the_air(stage)
    found |= await _hover(stage)
    found |= await _setpoints(stage)
    found |= await _other_station(stage)
    return found | await _landing(stage)


async def _take_off(stage: FlightStage) -> Values:
    await stage.ready()
    await stage.vehicle.arm()
    begun_s = stage.now_s
    await stage.vehicle.take_off(HEIGHT_M, 40.0)
    done_s = stage.now_s
    answer = stage.answer(TAKE_OFF, begun_s)
    sent_s = begun_s if answer is None else answer.time_s
    await stage.wait(2.0)
    track = FlightTrack.of(stage.bench.instants, sent_s)
    off_s = first(track.t, track.height > AIRBORNE_M, sent_s)
    final_m = float(np.mean(track.height[track.t > stage.now_s - 1.0]))
    high_s = first(track.t, track.height > 0.9 * final_m, sent_s)
    landed = landed_since(stage.heard.landed, sent_s, stage.now_s)
    return {
        "lift_off_s": off_s,
        "climb_mps": fastest_mps(track.t, track.height),
        "ramp_s": None if off_s is None or high_s is None else high_s - off_s,
        "overshoot_m": float(np.max(track.height)) - final_m,
        "take_off_s": done_s - sent_s,
        "mode_after_take_off": stage.heard.shown[-1].mode.value,
        "landed_states_up": in_words(landed),
        "in_air_s": when(landed, "in air"),
    }


async def _in_the_air(stage: FlightStage) -> Values:
    found: Values = {
        "arm_in_air": await stage.order(ARM, 1.0),
        "disarm_in_air": await stage.order(ARM, 0.0),
        "take_off_in_air": await stage.order_take_off(HEIGHT_M),
    }
    await stage.wait(0.5)
    found["take_off_in_air_then"] = stage.heard.shown[-1].mode.value
    await stage.vehicle.hold()
    await stage.wait(3.0)
    return found


async def _hover(stage: FlightStage) -> Values:
    """Eight seconds in HOLD: how still it stands, what its estimate is off by, how often it
    tells.
    """
    begin_s = stage.now_s
    await stage.wait(HOLD_S)
    track = FlightTrack.of(stage.bench.instants, begin_s)
    away = track.position - track.position[0]
    errors = estimate_errors([each for each in stage.bench.instants if each.time_s >= begin_s])
    found: Values = {
        "height_error_m": float(np.mean(track.height)) - HEIGHT_M,
        "drift_m": float(np.max(np.hypot(away[:, 0], away[:, 1]))),
        "height_drift_m": float(np.ptp(track.height)),
        **errors,
    }
    arrivals = stage.heard.arrivals_s
    for name, message in STREAMS.items():
        found[name] = rate_hz(arrivals.get(message, []), begin_s, stage.now_s)
    found["attitude_gap_s"] = longest_gap_s(arrivals.get(31, []), begin_s, stage.now_s)
    return found


async def _setpoints(stage: FlightStage) -> Values:
    found: Values = {"offboard_unready": await stage.order_mode(FlightMode.OFFBOARD)}
    await stage.wait(1.5)
    found["offboard_unready_then"] = stage.heard.shown[-1].mode.value
    await stage.vehicle.hold()
    await stage.wait(1.0)
    begun_s = stage.now_s
    yaw = stage.yaw_rad
    await _offboard(stage, yaw)
    found["offboard_s"] = stage.now_s - begun_s
    start_s = await stage.fly((STEP_MPS, 0.0, 0.0), yaw, STEP_S)
    stop_s = await stage.fly((0.0, 0.0, 0.0), yaw, 3.0)
    track = FlightTrack.of(stage.bench.instants, start_s)
    flown = track.t < stop_s
    answer = response(track.t[flown], track.velocity[flown, 0], start_s, STEP_MPS)
    found |= {
        "step_rise_s": answer.rise_s,
        "step_overshoot_percent": answer.overshoot_percent,
        "step_error_mps": answer.error_mps,
        "height_change_m": float(np.ptp(track.height)),
    }
    found["stop_s"], found["stop_m"] = standing(track, stop_s)
    return found | await _climb_and_turn(stage, yaw)


async def _climb_and_turn(stage: FlightStage, yaw: float) -> Values:
    up_s = await stage.fly((0.0, 0.0, -0.5), yaw, 3.0)
    still_s = await stage.fly((0.0, 0.0, 0.0), yaw, 1.5)
    track = FlightTrack.of(stage.bench.instants, up_s, still_s)
    climb = response(track.t, -track.velocity[:, 2], up_s, 0.5)
    turn_s = await stage.fly((0.0, 0.0, 0.0), yaw + math.pi / 2.0, 6.0)
    track = FlightTrack.of(stage.bench.instants, turn_s)
    turned = np.degrees(track.yaw - track.yaw[0])
    return {
        "climb_rise_s": climb.rise_s,
        "climb_overshoot_percent": climb.overshoot_percent,
        "yaw_rate_dps": fastest_mps(track.t, turned, 0.3),
        "yaw_s": first(track.t, turned > 85.0, turn_s),
        "yaw_overshoot_deg": max(0.0, float(np.max(turned)) - 90.0),
    }


async def _offboard(stage: FlightStage, yaw: float) -> None:
    await stage.vehicle.start_offboard(VelocitySetpoint((0.0, 0.0, 0.0), yaw))


async def _other_station(stage: FlightStage) -> Values:
    """Another ground station selects the hold while setpoints go on."""
    yaw = stage.yaw_rad
    sent_s = stage.now_s
    answer = await stage.order_mode(FlightMode.HOLD)
    seen_s = await stage.until(lambda: stage.vehicle.state.mode is FlightMode.HOLD, 3.0)
    seen_s = None if seen_s is None else stage.now_s - sent_s
    await stage.fly((0.3, 0.0, 0.0), yaw, 1.0)
    kept = stage.heard.shown[-1].mode
    await stage.wait(1.0)
    return {"other_hold": answer, "other_hold_seen_s": seen_s, "other_hold_then": kept.value}


async def _landing(stage: FlightStage) -> Values:
    begun_s = stage.now_s
    top_m = stage.height_m
    await stage.vehicle.land(60.0)
    await stage.wait(1.0)
    track = FlightTrack.of(stage.bench.instants, begun_s)
    touch_s = first(track.t, track.height < AIRBORNE_M, begun_s)
    shown = modes_since(stage.heard.shown, begun_s)
    landed = landed_since(stage.heard.landed, begun_s, stage.now_s)
    ground_s = when(landed[1:], "on ground")
    off_s = when(shown, "disarmed")
    just_before = (track.height > AIRBORNE_M) & (track.height < 0.25)
    return {
        "descend_mps": fastest_mps(track.t, -track.height),
        "touch_mps": float(np.mean(track.velocity[just_before, 2])) if just_before.any() else None,
        "land_s": touch_s,
        "land_from_m": top_m,
        "landed_states_down": in_words(landed),
        "touch_to_ground_s": None if touch_s is None or ground_s is None else ground_s - touch_s,
        "touch_to_disarmed_s": None if touch_s is None or off_s is None else off_s - touch_s,
    }


async def setpoints_stop(stage: FlightStage) -> Values:
    """The companion lives, its heartbeats come, its setpoints do not."""
    await stage.up(HEIGHT_M)
    await _offboard(stage, stage.yaw_rad)
    await stage.fly((0.5, 0.0, 0.0), stage.yaw_rad, 3.0)
    return await _left_alone(stage, "silent")


async def cable_cut(stage: FlightStage) -> Values:
    """Cut the cable while it flies by setpoints: nothing of the companion comes any more."""
    await stage.up(HEIGHT_M)
    await _offboard(stage, stage.yaw_rad)
    await stage.fly((0.5, 0.0, 0.0), stage.yaw_rad, 3.0)
    stage.bench.cut = True
    return await _left_alone(stage, "cut")


async def cable_cut_in_hold(stage: FlightStage) -> Values:
    """The same while it holds: no setpoints are missed, only heartbeats."""
    await stage.up(HEIGHT_M)
    stage.bench.cut = True
    return await _left_alone(stage, "cut_hold")


async def _left_alone(stage: FlightStage, name: str) -> Values:
    """Return what it does by itself within 20 s, by its heartbeats and by the truth."""
    from_s = stage.now_s
    await stage.until(lambda: not stage.armed, 20.0)
    changes = modes_since(stage.heard.shown, from_s)
    track = FlightTrack.of(stage.bench.instants, from_s)
    stood_s, stood_m = standing(track, from_s)
    return {
        f"{name}_modes": in_words(changes),
        f"{name}_s": changes[0][0] if changes else None,
        f"{name}_land_s": when(changes, "land"),
        f"{name}_down_s": first(track.t, track.height < AIRBORNE_M, from_s),
        f"{name}_stand_s": stood_s,
        f"{name}_stand_m": stood_m,
    }


async def pilot(stage: FlightStage) -> Values:
    """A mode that needs sticks, of a vehicle that has no remote control."""
    await stage.up(5.0)
    await stage.wait(1.0)
    from_s = stage.now_s
    height_m = stage.height_m
    main, sub = (3.0, 0.0) if stage.kind.name == "px4" else (5.0, 0.0)
    answer = await stage.order(SET_MODE, 1.0, main, sub)
    seen_s = await stage.until(lambda: stage.vehicle.state.mode is not FlightMode.HOLD, 2.0)
    seen_s = None if seen_s is None else stage.now_s - from_s
    await stage.until(lambda: stage.height_m < 1.5, max(0.0, from_s + 3.0 - stage.now_s))
    track = FlightTrack.of(stage.bench.instants, from_s)
    found: Values = {
        "pilot": answer,
        "pilot_seen_s": seen_s,
        "pilot_then": in_words(modes_since(stage.heard.shown, from_s)),
        "pilot_drop_m": height_m - float(track.height[-1]),
    }
    try:
        await stage.vehicle.hold()
    except VehicleError as error:
        found["pilot_hold_after"] = str(error)
    else:
        found["pilot_hold_after"] = "holds"
    return found


async def battery_and_kill(stage: FlightStage) -> Values:
    """Fly until nothing is left in the battery; and stop the motors by force before the ground."""
    await stage.up(HEIGHT_M)
    from_s = stage.now_s
    stage.bench.sag_battery(0.0)
    await stage.until(lambda: stage.height_m < 1.0, 30.0)
    changes = modes_since(stage.heard.shown, from_s)
    found: Values = {
        "battery_modes": in_words(changes),
        "battery_s": changes[0][0] if changes else None,
        "battery_land_s": when(changes, "land"),
        "battery_says": f"{100.0 * stage.vehicle.state.battery:.0f} %",
    }
    if stage.height_m > 1.0:
        await stage.vehicle.hold()
    kill_s = stage.now_s
    found["kill"] = await stage.order(ARM, 0.0, FORCE)
    await stage.until(lambda: not stage.armed, 3.0)
    found["kill_s"] = when(modes_since(stage.heard.shown, kill_s), "disarmed")
    await stage.wait(1.0)
    track = FlightTrack.of(stage.bench.instants, kill_s)
    found["kill_drop_mps"] = fastest_mps(track.t, -track.height, 0.2)
    return found


@frozen
class SuiteFlight:
    """One of the suite's flights; ``limit_s`` of the vehicle's time."""

    name: str
    what: str
    fly: Callable[[FlightStage], Awaitable[Values]]
    limit_s: float = 150.0


FLIGHTS = (
    SuiteFlight("ground", "commands on the ground", on_the_ground),
    SuiteFlight("course", "take-off, hover, setpoints, landing", course, 240.0),
    SuiteFlight("silent", "setpoints stop", setpoints_stop),
    SuiteFlight("cut", "the cable is cut while setpoints fly it", cable_cut),
    SuiteFlight("cut-hold", "the cable is cut while it holds", cable_cut_in_hold),
    SuiteFlight("pilot", "a pilot's mode without a pilot", pilot),
    SuiteFlight("battery", "battery empty, motors stopped by force", battery_and_kill),
)
