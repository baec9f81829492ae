"""The pilot's transmitter at the simulated autopilot: switches, sticks, and its loss."""

from __future__ import annotations

from dataclasses import replace

import pytest

from drivers.interfaces import FlightMode, VelocitySetpoint
from hil.autopilot.autopilot import Autopilot, AutopilotConfig, Estimate
from hil.autopilot.radio import (
    CENTRED,
    HIGH_US,
    LOW_US,
    MIDDLE_US,
    STICKS_SLOT,
    UNCHANGED,
    Radio,
    RadioConfig,
    flown_by,
)

TICK_S = 0.02
STILL = VelocitySetpoint((0.0, 0.0, 0.0), 0.0)


class Flown:
    """An autopilot in OFFBOARD at 2 m, with setpoints that never stop."""

    def __init__(self, **radio: float) -> None:
        config = AutopilotConfig(settle_s=0.0, radio=RadioConfig(**radio))  # pyright: ignore[reportArgumentType]
        self.autopilot = Autopilot(config, 1)
        self.held = self.autopilot.radio.transmitter
        self.now_s, self.height_m, self.thrust = 0.0, 0.0, False
        self.velocity = (0.0, 0.0, 0.0)
        self.run(0.1)
        assert self.autopilot.request_arm(self.now_s, True).accepted
        assert self.autopilot.request_takeoff(self.now_s, 2.0).accepted
        self.run(6.0)
        assert self.autopilot.request_mode(self.now_s, FlightMode.OFFBOARD).accepted
        self.run(0.1)

    def run(self, seconds: float, flown: bool = True) -> None:
        for _ in range(round(seconds / TICK_S)):
            if flown:
                self.autopilot.setpoint(self.now_s, STILL)
            estimate = Estimate(
                self.now_s, (0.0, 0.0, -self.height_m), self.velocity, (1.0, 0.0, 0.0, 0.0)
            )
            command = self.autopilot.step(self.now_s, estimate, self.height_m <= 0.0)
            self.thrust, self.velocity = (
                command.thrust_on,
                command.velocity_n_mps or (0.0, 0.0, 0.0),
            )
            fall_mps = 3.0 if not self.thrust else self.velocity[2]
            self.height_m = max(0.0, self.height_m - TICK_S * fall_mps)
            self.now_s += TICK_S


def test_a_switch_that_stands_there_from_the_start_orders_nothing() -> None:
    radio, config = Radio(), RadioConfig()
    radio.transmitter.slot, radio.transmitter.kill = STICKS_SLOT, True
    first = radio.step(0.0, config)
    assert (first.heard, first.mode, first.kill, first.moved) == (True, None, None, False)


def test_the_mode_switch_takes_an_offboard_vehicle_at_once() -> None:
    flown = Flown()
    flown.held.slot = STICKS_SLOT
    flown.run(TICK_S)
    assert flown.autopilot.mode is FlightMode.OTHER
    assert flown.autopilot.pilot_in_control
    assert flown.autopilot.status_texts[-1].text == "Pilot selected other"


def test_the_kill_switch_stops_the_motors_and_the_vehicle_calls_itself_armed_for_a_while() -> None:
    flown = Flown(kill_disarm_s=1.0)
    flown.held.kill = True
    flown.run(TICK_S)
    assert (flown.thrust, flown.autopilot.armed, flown.autopilot.powered) == (False, True, False)
    flown.run(1.1)
    assert not flown.autopilot.armed
    assert flown.autopilot.reasons == ("kill switch engaged",)


def test_a_kill_switch_thrown_back_in_time_lets_the_motors_turn_again() -> None:
    flown = Flown()
    flown.held.kill = True
    flown.run(0.1)
    flown.held.kill = False
    flown.run(TICK_S)
    assert flown.thrust and flown.autopilot.powered


def test_to_a_vehicle_whose_motors_its_pilot_stopped_nobody_owes_a_setpoint() -> None:
    flown = Flown()
    flown.held.kill = True
    flown.run(0.2, flown=False)
    flown.held.kill = False
    flown.run(0.25, flown=False)
    (session,) = flown.autopilot.offboard_sessions
    assert session.long_gaps == [] and session.end_s is not None
    assert flown.autopilot.mode is FlightMode.OFFBOARD
    flown.run(0.3, flown=False)
    assert flown.autopilot.mode is FlightMode.HOLD  # by its own failsafe


@pytest.mark.parametrize(
    ("override", "mode"), [(3, FlightMode.OTHER), (2, FlightMode.OTHER), (1, FlightMode.OFFBOARD)]
)
def test_grabbed_sticks_take_over_from_offboard_where_the_parameter_lets_them(
    override: int, mode: FlightMode
) -> None:
    flown = Flown(override=override)
    flown.held.sticks = (0.0, -0.6, 0.0, 0.0)
    flown.run(0.1)
    assert flown.autopilot.mode is mode


def test_a_stick_that_is_moved_slowly_is_no_grab() -> None:
    flown = Flown()
    for step in range(50):
        flown.held.sticks = (0.0, 0.012 * step, 0.0, 0.0)
        flown.run(2 * TICK_S)
    assert flown.autopilot.mode is FlightMode.OFFBOARD


def test_sticks_fly_the_vehicle_in_its_heading() -> None:
    assert flown_by(CENTRED, 0.3, 1.0) is None
    assert flown_by((0.0, 1.0, 0.0, 0.0), 0.0, 1.5) == (1.5, 0.0, -0.0)
    assert flown_by((0.0, 0.0, 1.0, 0.0), 0.0, 1.0) == (0.0, 0.0, -1.0)
    north, east, _ = flown_by((1.0, 0.0, 0.0, 0.0), 0.0, 1.0) or (0.0, 0.0, 0.0)
    assert (round(north, 9), round(east, 9)) == (0.0, 1.0)


def test_a_lost_radio_holds_and_then_lands() -> None:
    flown = Flown(act_after_s=2.0)
    flown.held.on = False
    flown.run(0.4)
    assert flown.autopilot.mode is FlightMode.OFFBOARD
    flown.run(0.2)
    assert (flown.autopilot.mode, flown.autopilot.failsafe) == (FlightMode.HOLD, "radio lost")
    flown.run(2.1)
    assert (flown.autopilot.mode, flown.autopilot.failsafe) == (FlightMode.LAND, "radio lost")


@pytest.mark.parametrize("radio", [{"in_mode": 4}, {"loss_except": 4}])
def test_a_loss_that_the_parameters_except_changes_nothing(radio: dict[str, float]) -> None:
    flown = Flown(**radio)
    flown.held.on = False
    flown.run(3.0)
    assert flown.autopilot.mode is FlightMode.OFFBOARD


def test_who_took_off_without_a_radio_does_not_miss_it() -> None:
    flown = Flown(fitted=False)
    flown.run(3.0)
    assert flown.autopilot.mode is FlightMode.OFFBOARD


@pytest.mark.parametrize("in_mode", [1, 4])
def test_values_that_ignore_the_radio_leave_the_pilot_nothing(in_mode: int) -> None:
    """The reason why no rig may ask for them."""
    flown = Flown(in_mode=in_mode)
    flown.held.slot, flown.held.kill, flown.held.sticks = STICKS_SLOT, True, (1.0, 1.0, 1.0, 1.0)
    flown.run(1.0)
    assert flown.autopilot.mode is FlightMode.OFFBOARD
    assert flown.thrust
    assert not flown.autopilot.radio_heard


def test_channels_from_a_ground_station_count_until_they_stop() -> None:
    radio, config = Radio(), RadioConfig(fitted=False)
    assert not radio.step(0.0, config).heard
    radio.override(
        0.1, (MIDDLE_US, MIDDLE_US, MIDDLE_US, MIDDLE_US, LOW_US, UNCHANGED, LOW_US, LOW_US)
    )
    assert radio.step(0.1, config).heard
    radio.override(0.2, (MIDDLE_US,) * 4 + (HIGH_US, UNCHANGED, HIGH_US, LOW_US))
    thrown = radio.step(0.2, config)
    assert (thrown.kill, thrown.mode) == (True, FlightMode.HOLD)
    assert radio.step(0.7, config).heard
    assert not radio.step(1.3, config).heard


def test_without_a_mapped_switch_there_is_none() -> None:
    radio, config = Radio(), replace(RadioConfig(), kill_channel=0, mode_channel=0)
    radio.step(0.0, config)
    radio.transmitter.kill, radio.transmitter.slot = True, STICKS_SLOT
    heard = radio.step(0.1, config)
    assert (heard.kill, heard.mode) == (None, None)
