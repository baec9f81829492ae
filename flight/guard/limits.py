"""Limits that beat every script: checked before each setpoint (S8-S10)."""

from __future__ import annotations

from drivers.interfaces import SURE, FlightMode, VehicleState
from flight.config import GuardConfig
from flight.guard.battery import battery_trouble
from flight.outcome import MissionEnd, Outcome


def check_vehicle(
    state: VehicleState,
    now_ns: int,
    config: GuardConfig,
    commanded: FlightMode,
) -> None:
    """Raise MissionEnd when the vehicle is no longer ours or no longer safe to fly.

    Args:
        state: newest telemetry.
        now_ns: role clock.
        config: limits.
        commanded: the mode the script put the vehicle in; any other mode means that somebody took
            over.
    """
    telemetry_age_s = (now_ns - state.stamp_ns) * 1e-9
    if telemetry_age_s > config.telemetry_age_s:
        raise MissionEnd(Outcome.VEHICLE_LOST, f"no telemetry for {telemetry_age_s:.1f} s")
    heartbeat_age_s = (now_ns - state.heartbeat_ns) * 1e-9
    if heartbeat_age_s > config.heartbeat_age_s:
        raise MissionEnd(Outcome.VEHICLE_LOST, f"no heartbeat for {heartbeat_age_s:.1f} s")
    if not state.armed:  # some autopilots keep the mode then
        raise MissionEnd(
            Outcome.PILOT_OVERRIDE, "the motors were stopped: the vehicle is no longer armed"
        )
    battery = battery_trouble(state.battery, state.battery_ns, now_ns, config.min_battery)
    if battery and state.mode is FlightMode.LAND:
        raise MissionEnd(Outcome.GUARD, f"{battery}, and the autopilot lands by itself")
    if state.mode is not commanded:
        raise MissionEnd(
            Outcome.PILOT_OVERRIDE, f"mode is {state.mode.value}, the script flew {commanded.value}"
        )
    north, east, down = state.position_n_m
    if not config.fence().holds(state.position_n_m):
        raise MissionEnd(
            Outcome.GUARD, f"outside the fence at ({north:.1f}, {east:.1f}) m, height {-down:.1f} m"
        )
    if battery:
        raise MissionEnd(Outcome.GUARD, battery)


def in_doubt(state: VehicleState, commanded: FlightMode) -> bool:
    """Return whether one message alone says that the vehicle is not the script's any more.

    Nothing is sent until the next one says so, too, or takes it back: a pilot does not wait for it,
    and one forged packet does not leave the vehicle to nobody.
    """
    if not state.armed:
        return state.armed_told < SURE
    return state.mode is not commanded and state.mode_told < SURE


def check_separation(distance_m: float, minimum_m: float) -> None:
    """Raise MissionEnd(TOO_CLOSE) when the measured distance between the drones is below the
    minimum (S9).
    """
    if not distance_m >= minimum_m:
        raise MissionEnd(
            Outcome.TOO_CLOSE, f"separation {distance_m:.2f} m is below {minimum_m:.2f} m"
        )
