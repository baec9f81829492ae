"""The embedded MAVLink vehicle under MAVSDK's own plugins, unmodified, in real time."""

import threading
import time
from collections.abc import Callable, Generator
from contextlib import ExitStack, contextmanager
from typing import Any

import pytest
from mavsdk.mavsdk import Configuration, Mavsdk
from mavsdk.plugins.action import Action
from mavsdk.plugins.offboard import Offboard, PositionNedYaw, VelocityNedYaw
from mavsdk.plugins.telemetry import Telemetry
from pymavlink.dialects.v20 import common as mavlink

from drivers.mavlink.modes import powered
from hil.autopilot.radio import STICKS_SLOT
from tests.exact_world import QUICK
from tests.hil.vehicle.mavlink_bench import START, SYSID, Bench
from tests.steady_time import SteadyTime


class RealTime:
    """Steps a bench in a thread, in real time. Keeps the largest pause, and every message that
    reached the vehicle.
    """

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.wire: list[Any] = []
        bench.vehicle.tap = lambda _, message: self.wire.append(message)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def __enter__(self) -> "RealTime":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        passed = SteadyTime()
        while not self._stop.wait(0.004):
            now_s = passed.now_s()
            self.bench.world.advance(now_s)
            self.bench.vehicle.pump(now_s)


def until(condition: Callable[[], bool], limit_s: float = 60.0) -> None:
    end_s = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < end_s, "the condition did not come"
        time.sleep(0.01)


@contextmanager
def connected(bench: Bench) -> Generator[tuple[RealTime, Any]]:
    """MAVSDK on the port the bench sends to."""
    port = bench.ground.getsockname()[1]
    bench.ground.close()
    with RealTime(bench) as world, Mavsdk(Configuration.create_manual(245, 190, True)) as mavsdk:
        mavsdk.add_any_connection_with_handle(f"udpin://127.0.0.1:{port}")
        system = mavsdk.first_autopilot(60.0)
        assert system is not None
        yield world, system


def test_mavsdks_own_plugins_fly_it(bench: Bench) -> None:
    with ExitStack() as stack:
        world, system = stack.enter_context(connected(bench))
        action, offboard, telemetry = Action(system), Offboard(system), Telemetry(system)
        seen: dict[str, Any] = {}

        def keep(name: str) -> Callable[[Any, Any], None]:
            return lambda value, _: seen.__setitem__(name, value)  # type: ignore[reportUnknownLambdaType]

        telemetry.subscribe_health(keep("health"))
        telemetry.subscribe_flight_mode(keep("mode"))
        telemetry.subscribe_in_air(keep("in_air"))
        telemetry.subscribe_position_velocity_ned(keep("ned"))
        until(
            lambda: (
                "health" in seen
                and seen["health"].is_armable
                and seen["health"].is_home_position_ok
            )
        )
        assert seen["health"].is_global_position_ok and seen["health"].is_local_position_ok
        action.set_takeoff_altitude(0.7)
        assert action.get_takeoff_altitude() == pytest.approx(0.7)
        action.arm()
        action.takeoff()
        until(lambda: seen["mode"].name == "HOLD" and seen["in_air"])
        offboard.set_velocity_ned(VelocityNedYaw(0.5, 0.0, 0.0, 90.0))
        offboard.start()
        until(lambda: seen["ned"].position.north_m > 0.3)
        assert bench.drone.estimate.position_n_m[0] > START[0] + 0.3
        offboard.set_position_ned(PositionNedYaw(0.0, 0.0, -0.7, 0.0))
        until(lambda: abs(seen["ned"].position.north_m) < 0.1)
        offboard.stop()  # selects HOLD
        until(lambda: seen["mode"].name == "HOLD")
        action.land()
        until(lambda: not bench.drone.autopilot.armed)
        assert bench.drone.autopilot.setpoint_gap_s < QUICK.offboard_loss_s
    kinds = {message.get_type() for message in world.wire}
    assert {"COMMAND_LONG", "SET_POSITION_TARGET_LOCAL_NED"} <= kinds


def test_the_transmitter_is_told_of_and_takes_the_vehicle(bench: Bench) -> None:
    bench.fly_at(0.8)
    receiver = mavlink.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
    assert bench.of("SYS_STATUS")[-1].onboard_control_sensors_health & receiver
    assert bench.of("RC_CHANNELS")[-1].chan7_raw == 1000
    bench.drone.autopilot.radio.transmitter.slot = STICKS_SLOT
    bench.run(0.7)
    assert bench.of("HEARTBEAT")[-1].custom_mode == 3 << 16
    bench.drone.autopilot.radio.transmitter.on = False
    bench.run(1.2)
    assert not bench.of("SYS_STATUS")[-1].onboard_control_sensors_present & receiver
    assert bench.of("RC_CHANNELS")[-1].rssi == 0


def test_a_kill_switch_shows_as_flight_termination_while_the_vehicle_calls_itself_armed(
    bench: Bench,
) -> None:
    """By channels of a ground station: seven is the kill switch."""
    bench.fly_at(0.8)

    def thrown(kill_us: int) -> None:
        channels = [1500, 1500, 1500, 1500, 65535, 65535, kill_us, 65535]
        bench.send(mavlink.MAVLink_rc_channels_override_message(SYSID, 1, *channels))

    bench.run(0.1, lambda: thrown(1000))
    bench.run(0.7, lambda: thrown(2000))
    told = bench.of("HEARTBEAT")[-1]
    assert told.system_status == mavlink.MAV_STATE_FLIGHT_TERMINATION
    assert told.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    assert not powered(told.base_mode, told.system_status)
