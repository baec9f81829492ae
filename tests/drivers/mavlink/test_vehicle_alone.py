"""The driver of a vehicle on a session and telemetry that stand in: what is refused, what is sent,
how often.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Coroutine
from types import SimpleNamespace
from typing import Any, cast

import pytest

from drivers.interfaces import FlightMode, VehicleError, VelocitySetpoint
from drivers.mavlink.modes import ARDUPILOT, PX4
from drivers.mavlink.vehicle import MavsdkVehicle
from drivers.mavlink.vehicle_config import MavsdkVehicleConfig
from hil.harness.virtual_time import run_virtual
from tests.drivers.mavlink.mavsdk_bench import CONTEXT, SYSID
from tests.drivers.mavlink.test_manoeuvres import Session as Sessions
from tests.drivers.mavlink.test_manoeuvres import Telemetry as Slots

SETPOINT = VelocitySetpoint((0.1, -0.2, 0.3), 1.2)


class Session(Sessions):
    """A session that also sends messages, to a vehicle that is heard."""

    def __init__(self) -> None:
        super().__init__()
        self.messages: list[tuple[float, str, dict[str, Any]]] = []
        self.looked = 0
        self.silent = False

    def send(self, name: str, fields: dict[str, Any]) -> None:
        self.messages.append((asyncio.get_running_loop().time(), name, fields))

    def boot_ms(self) -> int:
        return 77

    async def check_alive(self) -> None:
        self.looked += 1
        if self.silent:
            raise VehicleError("heartbeat lost", "check cable")


class Telemetry(Slots):
    """Telemetry of a vehicle on the ground."""

    height_m = 0.0
    in_air = False
    lacking: tuple[str, ...] = ()
    battery = SimpleNamespace(known=True, trouble="")
    attitude = None
    firmware = None

    def state(self) -> Any:
        return SimpleNamespace(
            armed=self.armed, in_air=self.in_air, position_n_m=(0.0, 0.0, -self.height_m)
        )

    def missing(self) -> list[str]:
        return list(self.lacking)


class Bench:
    def __init__(self, **options: Any) -> None:
        config = MavsdkVehicleConfig(url="udpin://127.0.0.1:14540", sysid=SYSID, **options)
        self.vehicle: Any = MavsdkVehicle(config, CONTEXT)
        self.session, self.telemetry = Session(), Telemetry()
        self.done: list[tuple[Any, ...]] = []
        self.slow = ""
        self.pilots = 0
        self.vehicle._session, self.vehicle._telemetry = self.session, self.telemetry
        self.vehicle._clock = self.telemetry.clock
        self.vehicle._manoeuvres = SimpleNamespace(
            kind=PX4,
            do=self._do,
            change_mode=self._change_mode,
            take_off=self._take_off,
            land=self._land,
        )
        self.vehicle._before = SimpleNamespace(check_pilot=self._check_pilot)
        self.vehicle._too_slow = lambda: self.slow
        self.vehicle.parameter_differences = self._differences
        self.differing: tuple[str, ...] = ()
        self.arms = True

    async def _differences(self) -> tuple[str, ...]:
        return self.differing

    async def _check_pilot(self) -> None:
        self.pilots += 1

    async def _do(self, what: str, command: int, params: tuple[float, ...]) -> None:
        self.done.append((what, command, params))
        self.telemetry.armed = self.arms

    async def _change_mode(self, mode: FlightMode, what: str, tries: int = 1) -> None:
        self.done.append((mode, what, tries))

    async def _take_off(self, height_m: float, timeout_s: float) -> None:
        self.done.append(("take off", height_m, timeout_s))

    async def _land(self, timeout_s: float) -> None:
        self.done.append(("land", timeout_s))


def with_vehicle(main: Callable[[Bench], Coroutine[Any, Any, None]], **options: Any) -> None:
    async def run() -> None:
        await main(Bench(**options))

    run_virtual(run())


async def refused(step: Coroutine[Any, Any, Any]) -> str:
    with pytest.raises(VehicleError) as caught:
        await step
    return str(caught.value)


@pytest.mark.parametrize(
    ("kind", "first"), [(PX4, []), (ARDUPILOT, [(FlightMode.OFFBOARD, "select GUIDED", 1)])]
)
def test_arming_is_commanded_once_and_seen(kind: Any, first: list[Any]) -> None:
    async def main(bench: Bench) -> None:
        bench.vehicle._manoeuvres.kind, bench.telemetry.armed = kind, False
        await bench.vehicle.arm()
        assert bench.done == [*first, ("arm", 400, (1.0, 0.0))]
        bench.arms = False
        assert "is not armed" in await refused(bench.vehicle.arm())
        assert asyncio.get_running_loop().time() == pytest.approx(3.0, abs=0.1)

    with_vehicle(main)


@pytest.mark.parametrize("height_m", [0.0, -1.0, math.nan, math.inf])
def test_nothing_takes_off_to_no_height_or_unarmed_or_unheard(height_m: float) -> None:
    async def main(bench: Bench) -> None:
        assert "height" in await refused(bench.vehicle.take_off(height_m, 9.0))
        bench.telemetry.armed = False
        assert "not armed" in await refused(bench.vehicle.take_off(1.5, 9.0))
        bench.telemetry.armed, bench.session.silent = True, True
        assert "heartbeat lost" in await refused(bench.vehicle.take_off(1.5, 9.0))
        assert bench.done == []
        bench.session.silent = False
        await bench.vehicle.take_off(1.5, 9.0)
        assert bench.done == [("take off", 1.5, 9.0)]

    with_vehicle(main)


def test_what_is_not_armed_has_landed_and_that_is_news() -> None:
    async def main(bench: Bench) -> None:
        bench.telemetry.armed = False
        await bench.vehicle.land(30.0)
        assert bench.done == [] and bench.session.looked == 1
        bench.telemetry.armed = True
        await bench.vehicle.land(30.0)
        assert bench.done == [("land", 30.0)]
        bench.session.silent = True
        assert "heartbeat lost" in await refused(bench.vehicle.land(30.0))

    with_vehicle(main)


def test_a_hold_is_commanded_again_when_nobody_answers() -> None:
    async def main(bench: Bench) -> None:
        await bench.vehicle.hold()
        assert bench.done == [(FlightMode.HOLD, "hold", 3)]

    with_vehicle(main)


def test_a_setpoint_is_a_velocity_and_a_yaw_in_the_local_frame() -> None:
    async def main(bench: Bench) -> None:
        bench.vehicle.fly(SETPOINT)
        ((_, name, fields),) = bench.session.messages
        assert name == "SET_POSITION_TARGET_LOCAL_NED"
        assert (fields["vx"], fields["vy"], fields["vz"], fields["yaw"]) == (0.1, -0.2, 0.3, 1.2)
        assert (fields["coordinate_frame"], fields["type_mask"], fields["time_boot_ms"]) == (
            1,
            0b100111000111,
            77,
        )
        assert {fields[name] for name in ("x", "y", "z", "afx", "afy", "afz", "yaw_rate")} == {0.0}

    with_vehicle(main)


@pytest.mark.parametrize("wrong", range(4))
def test_a_setpoint_that_is_not_finite_is_not_sent(wrong: int) -> None:
    async def main(bench: Bench) -> None:
        parts = [0.1, 0.2, 0.3, 0.4]
        parts[wrong] = math.nan
        with pytest.raises(VehicleError, match="not finite"):
            bench.vehicle.fly(VelocitySetpoint((parts[0], parts[1], parts[2]), parts[3]))
        assert bench.session.messages == []

    with_vehicle(main)


def test_setpoints_come_before_offboard_control_and_twenty_times_a_second() -> None:
    async def main(bench: Bench) -> None:
        begun: list[float] = []

        async def change_mode(mode: FlightMode, what: str, tries: int = 1) -> None:
            begun.append(asyncio.get_running_loop().time())
            assert (mode, what, tries) == (FlightMode.OFFBOARD, "enter offboard control", 1)
            await asyncio.sleep(0.5)

        bench.vehicle._manoeuvres.change_mode = change_mode
        await bench.vehicle.start_offboard(SETPOINT)
        times = [time_s for time_s, _, _ in bench.session.messages]
        assert begun[0] == pytest.approx(0.3, abs=0.03) and times[0] < 0.05
        assert len(times) == pytest.approx(16, abs=1)
        await asyncio.sleep(1.0)
        assert len(bench.session.messages) == len(times)  # from then on the pilot sends them

    with_vehicle(main)


def test_a_vehicle_is_armable_once_nothing_is_missing_and_its_pilot_was_looked_at() -> None:
    async def main(bench: Bench) -> None:
        bench.telemetry.lacking = ("home position",)
        waiting = asyncio.create_task(bench.vehicle.wait_armable(20.0))
        await asyncio.sleep(1.0)
        assert not waiting.done() and bench.pilots == 0
        bench.telemetry.lacking, bench.slow = (), "position too seldom"
        await asyncio.sleep(1.0)
        assert not waiting.done()
        bench.slow, bench.telemetry.battery = (
            "",
            SimpleNamespace(known=False, trouble="battery level"),
        )
        await asyncio.sleep(1.0)
        assert not waiting.done()
        bench.telemetry.battery = SimpleNamespace(known=True, trouble="")
        await waiting
        assert bench.pilots == 1 and bench.session.looked == 1

    with_vehicle(main)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            {"differing": ("COM_RCL_EXCEPT is 0, 4 is wanted",)},
            "is not set for this flight: COM_RCL_EXCEPT",
        ),
        ({"slow": "position too seldom"}, "tells its position too seldom"),
        (
            {"lacking": ("home position", "arming checks")},
            "waiting for home position, arming checks; the vehicle says",
        ),
        ({"trouble": "battery level"}, "waiting for battery level"),
    ],
)
def test_a_vehicle_that_is_not_armable_says_what_it_waits_for(
    changes: dict[str, Any], said: str
) -> None:
    async def main(bench: Bench) -> None:
        bench.differing, bench.slow = changes.get("differing", ()), changes.get("slow", "")
        bench.telemetry.lacking = changes.get("lacking", ())
        trouble = changes.get("trouble", "")
        bench.telemetry.battery = SimpleNamespace(known=not trouble, trouble=trouble)
        bench.telemetry.texts = ["old", "one", "two", "three"]
        told = await refused(bench.vehicle.wait_armable(20.0))
        assert said in told and bench.pilots == 0
        if "says" in said:
            assert "one | two | three" in told and "old" not in told
        late_s = 0.0 if "differing" in changes else 20.0
        assert asyncio.get_running_loop().time() == pytest.approx(late_s, abs=0.1)
        bench.session.silent = True
        assert "heartbeat lost" in await refused(bench.vehicle.wait_armable(20.0))

    with_vehicle(main)


@pytest.mark.parametrize(
    ("height_m", "in_air", "options", "stands"),
    [
        (3.0, False, {}, True),
        (3.1, False, {}, False),
        (-3.1, False, {}, False),
        (math.nan, False, {}, False),
        (3.1, True, {}, True),
        (3.1, False, {"height_from": "home"}, True),
        (3.1, False, {"ground_within_m": 4.0}, True),
    ],
)
def test_a_vehicle_on_the_ground_that_says_it_is_high_up_is_not_armed(
    height_m: float, in_air: bool, options: dict[str, Any], stands: bool
) -> None:
    async def main(bench: Bench) -> None:
        bench.telemetry.height_m, bench.telemetry.in_air = height_m, in_air
        if stands:
            await bench.vehicle.wait_armable(20.0)
        else:
            assert "above [origin]" in await refused(bench.vehicle.wait_armable(20.0))

    with_vehicle(main, **options)


def test_every_stream_is_asked_for_at_its_rate_and_a_vehicle_that_answers_nothing_is_refused() -> (
    None
):
    async def main(bench: Bench) -> None:
        await bench.vehicle._set_rates()
        assert all(command == 511 and tries == 3 for command, _, tries in bench.session.sent)
        rates = {
            int(cast(float, params[0])): 1e6 / cast(float, params[1])
            for _, params, _ in bench.session.sent
        }
        assert rates == pytest.approx(
            {
                0: 10.0,
                436: 20.0,
                31: 40.0,
                32: 40.0,
                33: 40.0,
                245: 5.0,
                1: 2.0,
                24: 2.0,
                132: 10.0,
                147: 1.0,
                242: 1.0,
            }
        )
        assert all(params[2] == 0.0 for _, params, _ in bench.session.sent)
        bench.session.result = 3  # unsupported: it keeps its own rates
        await bench.vehicle._set_rates()
        bench.session.result = None
        assert "answers no command" in await refused(bench.vehicle._set_rates())

    with_vehicle(main, telemetry_hz=40.0)


def test_a_heartbeat_s_rate_can_be_left_alone() -> None:
    async def main(bench: Bench) -> None:
        await bench.vehicle._set_rates()
        assert (
            0 not in [params[0] for _, params, _ in bench.session.sent]
            and len(bench.session.sent) == 10
        )

    with_vehicle(main, heartbeat_hz=0.0)


# --- opening it, and what the doctor asks


class Opened(Bench):
    """A vehicle whose session opens, and which is asked what it is."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.happened: list[str] = []
        self.session.open = self._open  # type: ignore[attr-defined]
        self.session.close = self._close  # type: ignore[attr-defined]
        self.vehicle._vision = None

    async def _open(self) -> Any:
        self.happened.append("opens")
        return ARDUPILOT

    async def _close(self) -> None:
        self.happened.append("closes")


def opened(main: Callable[[Opened], Coroutine[Any, Any, None]], **options: Any) -> None:
    async def run() -> None:
        await main(Opened(**options))

    run_virtual(run())


def test_a_vehicle_is_open_once_its_attitude_is_heard_and_is_closed_again() -> None:
    async def main(bench: Opened) -> None:
        bench.telemetry.attitude = object()  # type: ignore[assignment]
        async with bench.vehicle as vehicle:
            assert vehicle is bench.vehicle and vehicle._manoeuvres.kind is ARDUPILOT
            assert len(bench.session.sent) == 11  # every stream was asked for
        assert bench.happened == ["opens", "closes"]

    opened(main)


def test_a_vehicle_without_an_attitude_is_closed_and_told() -> None:
    async def main(bench: Opened) -> None:
        with pytest.raises(VehicleError, match=r"no attitude from vehicle 7 on udpin.* in 10 s"):
            await bench.vehicle.__aenter__()
        assert bench.happened == ["opens", "closes"]
        assert asyncio.get_running_loop().time() == pytest.approx(10.0, abs=0.5)

    opened(main)


@pytest.mark.parametrize(
    ("kind", "height_from", "flies"),
    [(PX4, "sea_level", False), (PX4, "home", True), (ARDUPILOT, "sea_level", True)],
)
def test_positions_are_fed_while_it_is_open_but_not_to_a_px4_that_flies_by_altitude(
    kind: Any, height_from: Any, flies: bool
) -> None:
    async def main(bench: Opened) -> None:
        fed: list[str] = []

        async def run() -> None:
            fed.append("feeds")
            try:
                await asyncio.sleep(1e6)
            finally:
                fed.append("ends")

        async def open_it() -> Any:
            return kind

        bench.session.open = open_it  # type: ignore[attr-defined]
        bench.telemetry.attitude = object()  # type: ignore[assignment]
        bench.vehicle._vision = SimpleNamespace(run=run)
        if not flies:
            with pytest.raises(VehicleError, match="without GPS knows no altitude"):
                await bench.vehicle.__aenter__()
            assert fed == []
            return
        async with bench.vehicle:
            await asyncio.sleep(1.0)
            assert fed == ["feeds"]
        assert fed == ["feeds", "ends"] and bench.happened == ["closes"]

    opened(main, height_from=height_from)


@pytest.mark.parametrize("firmware", [None, "1.17.0"])
def test_the_doctor_is_told_what_it_is_what_it_waits_for_and_what_it_says(
    firmware: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def main(bench: Opened) -> None:
        telemetry = bench.telemetry
        telemetry.firmware = firmware  # type: ignore[assignment]
        telemetry.lacking = ("home position", "arming checks")
        telemetry.texts = ["old", "one", "two", "three"]
        stamped = SimpleNamespace(arrival_ns=5)
        telemetry.attitude, telemetry.position = stamped, None  # type: ignore[assignment]
        asked: list[tuple[Any, ...]] = []

        async def counted(streams: Any, rate_hz: float, fix: str) -> list[Any]:
            asked.append(({name: look() for name, look in streams.items()}, rate_hz))
            return []

        said = telemetry.texts_since
        since: list[int] = []

        def texts_since(_stamp_ns: int) -> list[str]:
            since.append(_stamp_ns)
            return said(_stamp_ns)

        telemetry.texts_since = texts_since
        monkeypatch.setattr("drivers.mavlink.vehicle.counted", counted)
        first, waits, says = await bench.vehicle.examine()
        known = f"firmware {firmware}" if firmware else "that does not tell its firmware"
        assert (first.state, first.name) == ("ok", "autopilot")
        assert first.detail == f"px4, {known}, system id 7"
        assert (waits.state, waits.detail) == ("note", "home position, arming checks")
        assert (says.state, says.detail) == ("note", "one | two | three")
        assert asked == [({"attitude": 5, "position": None}, 40.0)]
        assert bench.session.sent == [(512, (148,), 3)] and since == [0]  # from the beginning
        telemetry.lacking, telemetry.texts = (), []
        assert len(await bench.vehicle.examine()) == 1
        timeout_s = 0.0 if firmware else 2.0 * bench.vehicle._config.command_timeout_s
        assert asyncio.get_running_loop().time() == pytest.approx(timeout_s, abs=0.2)

    opened(main, telemetry_hz=40.0)


@pytest.mark.parametrize(
    ("heard", "below", "trouble", "wrong", "said"),
    [
        (False, None, "", "orientation 25", ""),
        (True, None, "too near", "", "nothing at present: too near"),
        (True, None, "", "", "its newest word is old"),
        (True, SimpleNamespace(distance_m=1.234), "", "", "1.23 m above the ground"),
    ],
)
def test_a_rangefinder_is_listened_for(
    heard: bool, below: Any, trouble: str, wrong: str, said: str
) -> None:
    async def main(bench: Opened) -> None:
        asked: list[int] = []

        def at(now_ns: int) -> Any:
            asked.append(now_ns)
            return below

        own: Any = SimpleNamespace(heard=heard, at=at, trouble=trouble)
        bench.telemetry.rangefinder = own  # type: ignore[attr-defined]
        fault, found = await bench.vehicle.rangefinder(2.0)
        assert (wrong in fault) if wrong else fault == ""
        assert (said in found) if said else found == ""
        assert asked == ([bench.telemetry.clock.now_ns()] if heard else [])
        waited_s = asyncio.get_running_loop().time()
        assert waited_s == pytest.approx(0.0 if heard else 2.0, abs=0.1)

    opened(main)


def test_positions_are_fed_by_the_rig_s_own_table(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[tuple[Any, ...]] = []

    def feed(*args: Any) -> str:
        made.append(args)
        return "a feed"

    monkeypatch.setattr("drivers.mavlink.vehicle.VisionFeed", feed)
    vision: Any = SimpleNamespace()
    config = MavsdkVehicleConfig(url="udpin://127.0.0.1:14540", sysid=SYSID)
    object.__setattr__(config, "vision", vision)
    vehicle: Any = MavsdkVehicle(config, CONTEXT)
    assert vehicle._vision == "a feed"
    assert made == [(vision, CONTEXT, vehicle._session, vehicle._telemetry)]
    assert vehicle._telemetry._without_gps


def test_an_age_of_telemetry_is_the_flight_s_own_once_it_is_said(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[float] = []

    def too_slow(_arrivals: object, _now_ns: int, oldest_s: float) -> str:
        asked.append(oldest_s)
        return ""

    monkeypatch.setattr("drivers.mavlink.vehicle.too_slow", too_slow)
    config = MavsdkVehicleConfig(url="udpin://127.0.0.1:14540", sysid=SYSID)

    async def main() -> None:
        vehicle: Any = MavsdkVehicle(config, CONTEXT)
        vehicle._too_slow()
        vehicle.expect_telemetry(0.3)
        vehicle._too_slow()

    run_virtual(main())
    assert asked == [0.5, 0.3]
