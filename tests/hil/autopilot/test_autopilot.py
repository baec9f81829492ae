"""The autopilot on a drone that follows every velocity exactly: modes, refusals, failsafes."""

import math
from collections.abc import Callable
from dataclasses import replace

import pytest

from drivers.interfaces import FlightMode, VelocitySetpoint
from hil.autopilot.autopilot import Ack, Autopilot, AutopilotConfig, Estimate
from hil.autopilot.values import FenceConfig
from path.geometry.rotation import quat_from_rpy, yaw_of

TICK_S = 0.02
LEVEL = (1.0, 0.0, 0.0, 0.0)
STILL = VelocitySetpoint((0.0, 0.0, 0.0), 0.0)
NORTH = VelocitySetpoint((1.0, 0.0, 0.0), 0.0)


class Bench:
    """An autopilot and a point that moves as commanded; time goes in ticks."""

    def __init__(self, config: AutopilotConfig | None = None, seed: int = 0) -> None:
        self.autopilot = Autopilot(config or AutopilotConfig(), seed)
        self.now_s = 0.0
        self.position = [0.0, 0.0, 0.0]
        self.velocity = (0.0, 0.0, 0.0)
        self.yaw = 0.4
        self.thrust = False

    def tick(self) -> None:
        on_ground = self.position[2] >= 0.0 and self.velocity[2] >= 0.0
        q = quat_from_rpy(0.0, 0.0, self.yaw)
        x, y, z = self.position
        command = self.autopilot.step(
            self.now_s, Estimate(self.now_s, (x, y, z), self.velocity, q), on_ground
        )
        self.thrust, self.yaw = command.thrust_on, command.yaw_rad
        assert self.thrust or on_ground, "motors stopped in the air"
        self.velocity = command.velocity_n_mps or (0.0, 0.0, 0.0)
        self.position = [p + TICK_S * v for p, v in zip(self.position, self.velocity, strict=True)]
        self.position[2] = min(0.0, self.position[2])
        self.now_s += TICK_S

    def until(
        self,
        condition: Callable[[], bool],
        within_s: float = 30.0,
        setpoint: VelocitySetpoint | None = None,
    ) -> float:
        """Tick until the condition holds (how long it took), feeding a setpoint every tick if
        given.
        """
        start_s = self.now_s
        while not condition():
            assert self.now_s - start_s < within_s, (
                f"not within {within_s} s; mode {self.autopilot.mode}"
            )
            if setpoint is not None:
                self.autopilot.setpoint(self.now_s, setpoint)
            self.tick()
        return self.now_s - start_s

    def run(self, seconds: float, setpoint: VelocitySetpoint | None = None) -> None:
        end_s = self.now_s + seconds
        self.until(lambda: self.now_s >= end_s, seconds + 1.0, setpoint)

    def request(self, mode: FlightMode, by_pilot: bool = False) -> Ack:
        return self.autopilot.request_mode(self.now_s, mode, by_pilot)

    def fly(self, height_m: float = 1.5) -> "Bench":
        """Armed and holding at a height."""
        self.until(lambda: self.autopilot.armable)
        assert self.autopilot.request_arm(self.now_s, True).accepted
        assert self.autopilot.request_takeoff(self.now_s, height_m).accepted
        self.until(lambda: self.autopilot.mode is FlightMode.HOLD)
        self.run(2.0)
        return self

    def offboard(self, setpoint: VelocitySetpoint = STILL) -> "Bench":
        self.autopilot.setpoint(self.now_s, setpoint)
        assert self.request(FlightMode.OFFBOARD).accepted
        return self

    @property
    def texts(self) -> list[str]:
        return [entry.text for entry in self.autopilot.status_texts]


def test_settles_before_it_can_be_armed_and_says_why_not() -> None:
    bench = Bench()
    bench.tick()
    ack = bench.autopilot.request_arm(bench.now_s, True)
    assert not ack.accepted
    assert "settling" in ack.reason
    assert ack.reason in bench.texts
    assert not bench.autopilot.armed
    settled_s = bench.until(lambda: bench.autopilot.armable)
    assert settled_s == pytest.approx(2.5, rel=0.11)
    assert bench.autopilot.request_arm(bench.now_s, True).accepted


def test_settling_time_comes_from_the_seed() -> None:
    times = [_settled(seed) for seed in (1, 1, 2)]
    assert times[0] == times[1] != times[2]


def _settled(seed: int) -> float:
    bench = Bench(seed=seed)
    bench.tick()
    return bench.until(lambda: bench.autopilot.armable)


@pytest.mark.parametrize(
    ("config", "battery", "reason"),
    [
        (AutopilotConfig(arming_fault="compass not calibrated"), 1.0, "compass not calibrated"),
        (AutopilotConfig(), 0.05, "battery low"),
    ],
)
def test_refuses_to_arm_for_a_named_reason(
    config: AutopilotConfig, battery: float, reason: str
) -> None:
    bench = Bench(config)
    bench.autopilot.set_battery(battery)
    bench.run(5.0)
    ack = bench.autopilot.request_arm(bench.now_s, True, force=True)
    assert not ack.accepted
    assert reason in ack.reason
    assert bench.autopilot.reasons == (reason,)


def test_takes_off_spools_climbs_and_holds_at_height() -> None:
    bench = Bench()
    bench.until(lambda: bench.autopilot.armable)
    bench.autopilot.request_arm(bench.now_s, True)
    assert bench.autopilot.request_takeoff(bench.now_s, 2.0).accepted
    bench.run(0.9)
    assert bench.position[2] == 0.0
    assert bench.thrust
    bench.until(lambda: bench.autopilot.mode is FlightMode.HOLD)
    assert not bench.autopilot.landed
    bench.run(10.0)
    assert bench.position[2] == pytest.approx(-2.0, abs=0.01)
    assert bench.autopilot.mode is FlightMode.HOLD


def test_commands_can_be_resent() -> None:
    bench = Bench()
    bench.until(lambda: bench.autopilot.armable)
    for _ in range(3):
        assert bench.autopilot.request_arm(bench.now_s, True).accepted
    bench.tick()
    for _ in range(3):
        assert bench.autopilot.request_takeoff(bench.now_s, 1.5).accepted
        bench.run(0.5)
    bench.until(lambda: bench.autopilot.mode is FlightMode.HOLD)
    assert bench.position[2] == pytest.approx(-1.5, abs=0.15)
    for _ in range(3):
        assert bench.request(FlightMode.LAND).accepted
        bench.run(0.5)
    bench.until(lambda: not bench.autopilot.armed)
    assert bench.request(FlightMode.LAND).accepted
    assert bench.autopilot.request_arm(bench.now_s, False).accepted


@pytest.mark.parametrize("height_m", [0.0, -1.0, 31.0, math.inf])
def test_refuses_a_height_out_of_bounds(height_m: float) -> None:
    bench = Bench()
    bench.until(lambda: bench.autopilot.armable)
    assert not bench.autopilot.request_takeoff(bench.now_s, 1.5).accepted  # not armed
    bench.autopilot.request_arm(bench.now_s, True)
    assert not bench.autopilot.request_takeoff(bench.now_s, height_m).accepted
    assert bench.autopilot.mode is FlightMode.HOLD


def test_refuses_a_take_off_in_the_air() -> None:
    bench = Bench().fly()
    assert "already in the air" in bench.autopilot.request_takeoff(bench.now_s, 3.0).reason


def test_offboard_needs_a_fresh_setpoint() -> None:
    bench = Bench().fly()
    assert not bench.request(FlightMode.OFFBOARD).accepted
    bench.autopilot.setpoint(bench.now_s, STILL)
    bench.run(0.6)
    assert not bench.request(FlightMode.OFFBOARD).accepted
    bench.autopilot.setpoint(bench.now_s, STILL)
    assert bench.request(FlightMode.OFFBOARD).accepted


def test_non_finite_setpoints_are_not_setpoints() -> None:
    bench = Bench().fly()
    bad = VelocitySetpoint((math.nan, 0.0, 0.0), 0.0)
    assert not bench.autopilot.setpoint(bench.now_s, bad)
    assert not bench.request(FlightMode.OFFBOARD).accepted
    bench.offboard()
    bench.run(0.8, bad)
    assert bench.autopilot.mode is FlightMode.HOLD


def test_offboard_flies_the_setpoint_within_limits() -> None:
    bench = Bench().fly(3.0)
    wanted = VelocitySetpoint((1.0, -0.5, 0.0), 1.2)
    bench.offboard(wanted).run(1.0, wanted)
    assert bench.velocity == pytest.approx((1.0, -0.5, 0.0))
    assert bench.yaw == 1.2
    bench.run(0.2, VelocitySetpoint((30.0, 40.0, -9.0), 0.0))
    assert bench.velocity == pytest.approx((1.8, 2.4, -1.5))


def test_a_companion_that_dies_ends_on_the_ground() -> None:
    bench = Bench().fly()
    bench.offboard().run(3.0, STILL)
    lost_s = bench.until(lambda: bench.autopilot.mode is FlightMode.HOLD)
    assert 0.5 <= lost_s <= 0.56
    landing_s = bench.until(lambda: bench.autopilot.mode is FlightMode.LAND)
    assert landing_s == pytest.approx(1.0, abs=0.05)
    bench.until(lambda: not bench.autopilot.armed)
    assert bench.position[2] == 0.0
    assert any("setpoints, holding" in text for text in bench.texts)
    assert any("setpoints, landing" in text for text in bench.texts)


def test_a_companion_that_comes_back_keeps_the_drone_in_the_air() -> None:
    bench = Bench().fly()
    bench.offboard().run(1.0, STILL)
    bench.until(lambda: bench.autopilot.mode is FlightMode.HOLD)
    assert bench.request(FlightMode.HOLD).accepted
    bench.run(3.0)
    assert bench.autopilot.mode is FlightMode.HOLD


def test_keeps_the_longest_setpoint_gap_of_every_session() -> None:
    bench = Bench().fly()
    bench.offboard().run(1.0, STILL)
    bench.run(0.3)
    bench.run(0.5, STILL)
    bench.request(FlightMode.HOLD)
    bench.run(1.0)
    bench.offboard().run(1.0, STILL)
    first, second = bench.autopilot.offboard_sessions
    assert first.max_gap_s == pytest.approx(0.3, abs=0.05)
    assert first.ended_by is FlightMode.HOLD
    assert first.end_s is not None
    assert second.max_gap_s <= 0.05
    assert second.end_s is None
    assert bench.autopilot.setpoint_gap_s == first.max_gap_s


def test_a_gap_that_is_still_open_counts() -> None:
    bench = Bench().fly()
    bench.offboard().run(0.5, STILL)
    bench.run(0.4)
    assert bench.autopilot.setpoint_gap_s == pytest.approx(0.4, abs=0.05)


def test_what_was_not_sent_while_another_mode_flew_is_no_gap() -> None:
    bench = Bench().fly()
    bench.offboard().run(0.5, STILL)
    bench.request(FlightMode.HOLD)
    bench.run(0.4)
    assert bench.request(FlightMode.OFFBOARD).accepted
    bench.run(0.1)
    bench.run(0.5, STILL)
    assert bench.autopilot.setpoint_gap_s == pytest.approx(0.1, abs=0.05)


def test_lands_detects_the_ground_and_disarms() -> None:
    bench = Bench().fly()
    assert bench.request(FlightMode.LAND).accepted
    bench.until(lambda: bench.autopilot.landed)
    assert bench.autopilot.armed
    assert bench.until(lambda: not bench.autopilot.armed) == pytest.approx(1.0, abs=0.05)
    assert not bench.thrust
    assert bench.autopilot.mode is FlightMode.HOLD
    bench.run(1.0)
    assert bench.autopilot.request_arm(bench.now_s, True).accepted


def test_returns_climbs_flies_home_and_lands_there() -> None:
    bench = Bench().fly()
    away = VelocitySetpoint((1.0, 1.0, 0.0), 0.0)
    bench.offboard().run(4.0, away)
    assert bench.request(FlightMode.RETURN).accepted
    highest = 0.0
    while bench.autopilot.armed:
        bench.tick()
        highest = max(highest, -bench.position[2])
        assert bench.now_s < 60.0
        assert bench.autopilot.mode is FlightMode.RETURN or not bench.autopilot.armed
    assert highest == pytest.approx(2.5, abs=0.2)
    assert math.hypot(*bench.position[:2]) < 0.35


def test_disarms_when_nobody_takes_off() -> None:
    bench = Bench()
    bench.until(lambda: bench.autopilot.armable)
    bench.autopilot.request_arm(bench.now_s, True)
    assert bench.until(lambda: not bench.autopilot.armed) == pytest.approx(10.0, abs=0.1)


def test_disarming_stops_the_motors_in_the_air_only_by_force() -> None:
    bench = Bench().fly()
    ack = bench.autopilot.request_arm(bench.now_s, False)
    assert "in the air" in ack.reason
    bench.tick()
    assert bench.autopilot.armed
    assert bench.autopilot.request_arm(bench.now_s, False, force=True).accepted
    with pytest.raises(AssertionError, match="motors stopped in the air"):
        bench.tick()
    assert bench.texts[-1] == "Disarmed by force"


def test_on_the_ground_it_disarms_when_told_to() -> None:
    bench = Bench().fly()
    bench.request(FlightMode.LAND)
    bench.until(lambda: bench.autopilot.landed)
    assert bench.autopilot.request_arm(bench.now_s, False).accepted


LIKE_ARDUCOPTER = AutopilotConfig(
    offboard_loss_s=math.inf, setpoint_stale_s=3.0, companion_loss_s=2.0
)


def test_one_that_watches_no_setpoints_stands_still_when_they_are_stale() -> None:
    bench = Bench(LIKE_ARDUCOPTER).fly().offboard(NORTH)
    bench.run(2.9)
    assert bench.velocity[0] == pytest.approx(1.0)
    bench.run(0.2)
    assert (bench.velocity[0], bench.autopilot.mode) == (0.0, FlightMode.OFFBOARD)
    bench.run(10.0)
    assert bench.autopilot.mode is FlightMode.OFFBOARD


def test_one_that_watches_its_ground_station_lands_without_it() -> None:
    bench = Bench(LIKE_ARDUCOPTER).fly()
    bench.run(5.0)
    assert bench.autopilot.mode is FlightMode.HOLD  # nobody was ever heard
    bench.autopilot.companion_heard(bench.now_s)
    assert bench.until(lambda: bench.autopilot.mode is FlightMode.LAND) == pytest.approx(
        2.0, abs=0.1
    )
    assert bench.texts[-1] == "No ground station, landing"
    bench.until(lambda: not bench.autopilot.armed)


def test_a_landing_is_detected_after_as_long_as_it_takes() -> None:
    bench = Bench(AutopilotConfig(land_detect_s=2.3)).fly()
    bench.request(FlightMode.LAND)
    bench.until(lambda: bench.position[2] >= 0.0)
    assert bench.until(lambda: bench.autopilot.landed) == pytest.approx(2.3, abs=0.1)


def test_the_pilot_takes_offboard_away() -> None:
    bench = Bench().fly()
    bench.offboard().run(1.0, STILL)
    assert not bench.request(FlightMode.OTHER).accepted
    assert bench.request(FlightMode.OTHER, by_pilot=True).accepted
    away = VelocitySetpoint((1.0, 0.0, 0.0), 0.0)
    before = bench.position[0]
    bench.run(5.0, away)
    assert bench.autopilot.mode is FlightMode.OTHER
    assert bench.autopilot.pilot_in_control
    assert bench.position[0] == pytest.approx(before, abs=0.05)


def test_battery_drains_in_flight() -> None:
    bench = Bench(replace(AutopilotConfig(), endurance_s=100.0)).fly()
    before = bench.autopilot.battery
    bench.run(10.0)
    assert before - bench.autopilot.battery == pytest.approx(0.1, abs=0.002)


def test_a_low_battery_lands_whatever_the_script_wants() -> None:
    bench = Bench().fly()
    bench.offboard().run(0.5, STILL)
    bench.autopilot.set_battery(0.09)
    bench.run(0.1, STILL)
    assert bench.autopilot.mode is FlightMode.LAND
    for mode in (FlightMode.OFFBOARD, FlightMode.HOLD, FlightMode.RETURN):
        assert not bench.request(mode).accepted
    assert bench.request(FlightMode.OTHER, by_pilot=True).accepted
    bench.run(1.0)
    assert bench.autopilot.mode is FlightMode.OTHER


def test_turns_to_where_it_looked_and_stays_there() -> None:
    bench = Bench().fly()
    look = VelocitySetpoint((0.0, 0.0, 0.0), -2.0)
    bench.offboard().run(0.5, look)
    bench.request(FlightMode.HOLD)
    bench.run(3.0)
    assert yaw_of(quat_from_rpy(0.0, 0.0, bench.yaw)) == pytest.approx(-2.0)


def test_a_take_off_between_landing_and_disarming_is_not_cut_short() -> None:
    bench = Bench().fly()
    bench.request(FlightMode.LAND)
    bench.until(lambda: bench.autopilot.landed)
    assert bench.autopilot.request_takeoff(bench.now_s, 1.0).accepted
    bench.until(lambda: bench.autopilot.mode is FlightMode.HOLD)
    bench.run(3.0)
    assert bench.autopilot.armed
    assert bench.position[2] == pytest.approx(-1.0, abs=0.02)


def test_a_kill_switch_stops_the_motors_in_the_air_and_nothing_starts_them_again() -> None:
    bench = Bench().fly()
    bench.autopilot.kill(bench.now_s)
    command = bench.autopilot.step(
        bench.now_s, Estimate(bench.now_s, (0.0, 0.0, -1.5), (0.0, 0.0, 0.0), LEVEL), False
    )
    assert not command.thrust_on
    assert not bench.autopilot.armed
    assert not bench.autopilot.request_arm(bench.now_s, True).accepted
    assert bench.autopilot.status_texts[-1].text == "Arming denied: kill switch engaged"


@pytest.mark.parametrize(
    ("action", "mode"),
    [(2, FlightMode.HOLD), (3, FlightMode.RETURN), (5, FlightMode.LAND), (1, FlightMode.OFFBOARD)],
)
def test_outside_its_own_fence_the_autopilot_acts_by_itself_and_once(
    action: int, mode: FlightMode
) -> None:
    bench = Bench(
        AutopilotConfig(settle_s=0.0, fence=FenceConfig(action, radius_m=2.0, height_m=4.0))
    )
    bench.fly(1.5)
    bench.run(0.1, NORTH)
    assert bench.request(FlightMode.OFFBOARD).accepted
    bench.run(4.0, NORTH)
    assert bench.autopilot.mode is mode
    assert bool(bench.autopilot.failsafe) is (action != 1)
    if mode is FlightMode.HOLD:
        assert bench.request(FlightMode.OTHER, by_pilot=True).accepted
        bench.run(1.0)
        assert (bench.autopilot.mode, bench.autopilot.failsafe) == (FlightMode.OTHER, "")
