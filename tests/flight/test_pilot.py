"""The control loop in virtual time: never silent in control, never a word after it let go."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, Self

import pytest

from drivers.interfaces import FlightMode, VehicleState, VelocitySetpoint
from flight.config import MissionConfig
from flight.guidance import norm, subtract
from flight.outcome import MissionEnd, Outcome
from flight.pilot import DOUBT_S, Pilot
from hil.autopilot.values import MAX_SETPOINT_GAP_S
from hil.harness.virtual_time import run_virtual
from tests.doubles import LoopClock

YAW_HALF = (0.9238795325112867, 0.0, 0.0, 0.3826834323650898)  # 45 degrees to the right
GROUND = VehicleState(
    0, 0, (0.0, 0.0, -1.5), (0.0, 0.0, 0.0), YAW_HALF, True, True, True, FlightMode.HOLD, 0.9
)


@dataclass
class FakeVehicle:
    """Says it is well, and writes down what it is told and when."""

    state_now: VehicleState = GROUND
    flown: list[tuple[float, VelocitySetpoint]] = field(
        default_factory=list[tuple[float, VelocitySetpoint]]
    )
    silent: bool = False

    @property
    def state(self) -> VehicleState:
        if not self.silent:
            now_ns = LoopClock().now_ns()
            self.state_now = replace(self.state_now, stamp_ns=now_ns, heartbeat_ns=now_ns)
        return self.state_now

    async def start_offboard(self, first: VelocitySetpoint) -> None:
        self.fly(first)
        self.state_now = replace(self.state_now, mode=FlightMode.OFFBOARD)

    def fly(self, setpoint: VelocitySetpoint) -> None:
        self.flown.append((asyncio.get_running_loop().time(), setpoint))

    def attitude_at(self, stamp_ns: int) -> tuple[float, float, float, float]:
        return self.state_now.q_n_b

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None: ...
    async def wait_armable(self, timeout_s: float) -> None: ...
    async def arm(self) -> None: ...
    async def take_off(self, height_m: float, timeout_s: float) -> None: ...
    async def hold(self) -> None: ...
    async def land(self, timeout_s: float) -> None: ...

    def gaps_s(self) -> list[float]:
        return [later - earlier for (earlier, _), (later, _) in pairwise(self.flown)]


@dataclass
class ListLog:
    records: list[tuple[str, int, dict[str, Any]]] = field(
        default_factory=list[tuple[str, int, dict[str, Any]]]
    )

    def write(self, topic: str, stamp_ns: int, record: Any) -> None:
        self.records.append((topic, stamp_ns, dict(record)))

    def image(self, topic: str, stamp_ns: int, image: Any) -> None: ...


@dataclass
class Flight:
    config: MissionConfig = MissionConfig(control_hz=25.0)  # noqa: RUF009
    vehicle: FakeVehicle = field(default_factory=FakeVehicle)
    log: ListLog = field(default_factory=ListLog)

    def __post_init__(self) -> None:
        self.pilot = Pilot(self.vehicle, LoopClock(), self.config, self.log)

    async def for_a_while(self, seconds: float) -> asyncio.Task[None]:
        await self.pilot.take_control()
        task = asyncio.create_task(self.pilot.run())
        await asyncio.sleep(seconds)
        return task


async def ended(task: asyncio.Task[None]) -> MissionEnd:
    with pytest.raises(MissionEnd) as caught:
        await task
    return caught.value


def fly(main: Coroutine[Any, Any, None]) -> None:
    run_virtual(main)


def test_setpoints_come_at_the_control_rate() -> None:
    async def main() -> None:
        flight = Flight()
        task = await flight.for_a_while(4.0)
        task.cancel()
        gaps = flight.vehicle.gaps_s()[1:]
        assert len(gaps) == pytest.approx(100, abs=2)
        assert gaps == pytest.approx([0.04] * len(gaps))

    fly(main())


@pytest.mark.parametrize("control_hz", [10.0, 25.0, 50.0])
def test_no_guidance_makes_a_gap(control_hz: float) -> None:
    """S8: whoever exchanges the guidance, and however often, setpoints never gap."""

    async def main() -> None:
        flight = Flight(MissionConfig(control_hz=control_hz))
        task = await flight.for_a_while(0.0)
        for k in range(200):
            await asyncio.sleep(0.013)
            if k % 3:
                flight.pilot.hold_here()
            else:
                flight.pilot.guidance = lambda state: VelocitySetpoint((5.0, 0.0, 0.0), 0.0)
        task.cancel()
        assert max(flight.vehicle.gaps_s()) < 0.2

    fly(main())


def test_a_stall_is_not_made_up_for_with_a_burst() -> None:
    async def main() -> None:
        flight = Flight()
        task = await flight.for_a_while(1.0)
        loop: Any = asyncio.get_running_loop()
        loop.jump(0.9)  # the program did not run for that long: the machine was busy
        stalled_s = loop.time()
        await asyncio.sleep(0.5)
        task.cancel()
        after = [time_s for time_s, _ in flight.vehicle.flown if time_s >= stalled_s]
        assert len(after) <= 0.5 / 0.04 + 2

    fly(main())


def test_control_begins_at_a_standstill_in_the_present_heading() -> None:
    async def main() -> None:
        flight = Flight()
        # of an earlier stay in control
        flight.pilot.guidance = lambda state: VelocitySetpoint((1.0, 0.0, 0.0), 0.0)
        task = await flight.for_a_while(0.5)
        task.cancel()
        first = flight.vehicle.flown[0][1]
        assert first.velocity_n_mps == (0.0, 0.0, 0.0)
        assert [s.yaw_rad for _, s in flight.vehicle.flown] == pytest.approx(
            [0.7853981634] * len(flight.vehicle.flown)
        )
        assert all(norm(s.velocity_n_mps) == 0.0 for _, s in flight.vehicle.flown)

    fly(main())


def test_a_leap_of_the_guidance_is_slewed() -> None:
    async def main() -> None:
        flight = Flight()
        task = await flight.for_a_while(0.2)
        flight.pilot.guidance = lambda state: VelocitySetpoint((2.0, 0.0, 0.0), 0.3)
        await asyncio.sleep(5.0)
        task.cancel()
        for (_, before), (_, after) in pairwise(flight.vehicle.flown):
            change = norm(subtract(after.velocity_n_mps, before.velocity_n_mps))
            assert change <= MissionConfig().max_accel_mps2 * 0.04 + 1e-9
        assert flight.vehicle.flown[-1][1].velocity_n_mps == pytest.approx((2.0, 0.0, 0.0))
        assert flight.vehicle.flown[-1][1].yaw_rad == 0.3

    fly(main())


def test_hold_here_returns_to_where_it_was_called() -> None:
    async def main() -> None:
        flight = Flight()
        task = await flight.for_a_while(0.1)
        flight.pilot.hold_here()
        # a gust
        flight.vehicle.state_now = replace(flight.vehicle.state_now, position_n_m=(1.0, 0.0, -1.5))
        await asyncio.sleep(2.0)
        task.cancel()
        north, east, down = flight.vehicle.flown[-1][1].velocity_n_mps
        assert north < -0.5
        assert (east, down) == (0.0, 0.0)

    fly(main())


@pytest.mark.parametrize(
    ("outcome", "change"),
    [
        (Outcome.PILOT_OVERRIDE, {"mode": FlightMode.OTHER}),
        (Outcome.GUARD, {"battery": 0.1}),
        (Outcome.GUARD, {"position_n_m": (100.0, 0.0, -1.0)}),
    ],
)
def test_a_tripped_guard_ends_the_run_before_the_next_setpoint(
    outcome: Outcome, change: dict[str, Any]
) -> None:
    async def main() -> None:
        flight = Flight()
        task = await flight.for_a_while(1.0)
        assert flight.pilot.in_control
        flight.vehicle.state_now = replace(flight.vehicle.state_now, **change)
        sent = len(flight.vehicle.flown)
        assert (await ended(task)).outcome is outcome
        assert len(flight.vehicle.flown) == sent
        assert not flight.pilot.in_control

    fly(main())


def test_a_vehicle_that_falls_silent_is_lost() -> None:
    async def main() -> None:
        flight = Flight()
        task = await flight.for_a_while(1.0)
        flight.vehicle.silent = True
        assert (await ended(task)).outcome is Outcome.VEHICLE_LOST

    fly(main())


def test_guidance_that_fails_ends_the_run() -> None:
    async def main() -> None:
        flight = Flight()
        task = await flight.for_a_while(1.0)

        def fail(state: VehicleState) -> VelocitySetpoint:
            raise MissionEnd(Outcome.TARGET_LOST, "no track")

        flight.pilot.guidance = fail
        assert (await ended(task)).outcome is Outcome.TARGET_LOST
        assert not flight.pilot.in_control

    fly(main())


def test_letting_go_is_the_last_word() -> None:
    async def main() -> None:
        flight = Flight()
        task = await flight.for_a_while(1.0)
        flight.pilot.let_go()
        sent = len(flight.vehicle.flown)
        await task  # ends by itself
        await asyncio.sleep(1.0)
        assert len(flight.vehicle.flown) == sent

    fly(main())


def test_a_cancelled_run_is_out_of_control() -> None:
    async def main() -> None:
        flight = Flight()
        task = await flight.for_a_while(1.0)
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        assert not flight.pilot.in_control

    fly(main())


def test_every_setpoint_is_logged() -> None:
    async def main() -> None:
        flight = Flight()
        flight.pilot.guidance = lambda state: VelocitySetpoint((1.0, 0.0, 0.0), 0.0)
        task = await flight.for_a_while(1.0)
        task.cancel()
        flown = [
            (round(time_s * 1e9), s.velocity_n_mps, s.yaw_rad)
            for time_s, s in flight.vehicle.flown[1:]
        ]
        logged = [(stamp, r["velocity_n_mps"], r["yaw_rad"]) for _, stamp, r in flight.log.records]
        assert logged == flown
        assert {topic for topic, _, _ in flight.log.records} == {"/setpoint"}

    fly(main())


GONE = ({"mode": FlightMode.OTHER, "mode_told": 1}, {"armed": False, "armed_told": 1})


@pytest.mark.parametrize("said", GONE)
def test_one_message_that_somebody_took_it_stops_setpoints_until_it_is_taken_back(
    said: dict[str, Any],
) -> None:
    async def main() -> None:
        flight = Flight()
        task = await flight.for_a_while(1.0)
        ours, vehicle = flight.vehicle.state_now, flight.vehicle
        before = len(vehicle.flown)
        vehicle.state_now = replace(ours, **said)
        await asyncio.sleep(0.8 * DOUBT_S)
        assert len(vehicle.flown) == before and not task.done()
        vehicle.state_now = ours
        await asyncio.sleep(0.5)
        assert len(vehicle.flown) > before + 10 and not task.done()
        assert flight.pilot.override == "" and flight.pilot.in_control
        assert (
            [topic for topic, _, _ in flight.log.records].count("/doubt")
            == flight.pilot.taken_back
            == 1
        )
        task.cancel()

    fly(main())


@pytest.mark.parametrize(
    ("said", "confirmed"), [(GONE[0], {"mode_told": 2}), (GONE[1], {"armed_told": 2})]
)
def test_a_second_message_confirms_it_and_no_setpoint_is_sent_meanwhile(
    said: dict[str, Any], confirmed: dict[str, Any]
) -> None:
    async def main() -> None:
        flight = Flight()
        task = await flight.for_a_while(1.0)
        vehicle = flight.vehicle
        before = len(vehicle.flown)
        vehicle.state_now = replace(vehicle.state_now, **said)
        await asyncio.sleep(0.5 * DOUBT_S)
        vehicle.state_now = replace(vehicle.state_now, **confirmed)
        await asyncio.sleep(0.05)
        assert task.done() and len(vehicle.flown) == before
        assert (await ended(task)).outcome is Outcome.PILOT_OVERRIDE
        assert flight.pilot.override and not flight.pilot.taken_back

    fly(main())


@pytest.mark.parametrize("said", GONE)
@pytest.mark.parametrize("control_hz", [10.0, 20.0, 25.0, 50.0])
def test_a_word_that_is_taken_back_leaves_no_gap_that_S8_would_count(
    said: dict[str, Any], control_hz: float
) -> None:
    async def main() -> None:
        flight = Flight(MissionConfig(control_hz=control_hz))
        task = await flight.for_a_while(1.0)
        vehicle = flight.vehicle
        ours = vehicle.state_now
        for early_s in (0.0, 0.011, 0.023, 0.037):
            await asyncio.sleep(0.5 + early_s)
            vehicle.state_now = replace(ours, **said)
            await asyncio.sleep(0.99 * DOUBT_S)  # as late as it may be
            vehicle.state_now = ours
        await asyncio.sleep(0.5)
        assert max(vehicle.gaps_s()) <= MAX_SETPOINT_GAP_S + 1e-6
        assert flight.pilot.taken_back and not task.done()
        task.cancel()

    fly(main())


def test_what_nothing_takes_back_has_happened() -> None:
    async def main() -> None:
        flight = Flight()
        task = await flight.for_a_while(1.0)
        vehicle = flight.vehicle
        before = len(vehicle.flown)
        vehicle.state_now = replace(vehicle.state_now, mode=FlightMode.HOLD, mode_told=1)
        await asyncio.sleep(DOUBT_S + 0.1)
        assert (await ended(task)).outcome is Outcome.PILOT_OVERRIDE
        assert len(vehicle.flown) == before

    fly(main())
