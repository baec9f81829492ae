"""Preflight, take-off and the way down: what must come true, in which order, and who keeps the
vehicle.
"""

from __future__ import annotations

import asyncio
import random
from collections.abc import Coroutine
from dataclasses import dataclass, field, replace
from typing import Any, cast

import numpy as np
import pytest

from drivers.interfaces import (
    CameraError,
    Capability,
    FlightMode,
    LinkCounters,
    Received,
    TakenOver,
    VehicleError,
    VehicleState,
    VelocitySetpoint,
)
from drivers.mavlink.guard.interfaces import Script
from flight.config import Deadlines, GuardConfig, MissionConfig
from flight.guidance import Anchor, add, norm, scale, subtract
from flight.harness.flights import RoleResult
from flight.keep_out import Body
from flight.outcome import MissionEnd, Outcome
from hil.harness.virtual_time import run_virtual
from missions.fly.leg.course import fly_course
from missions.fly.leg.session import RoleSession
from missions.fly.leg.steps import bring_down, check_capabilities, preflight, take_off
from path.belief.motion import Motion
from path.messages import Pong, Role, Status
from tests.doubles import LoopClock

HOME = VehicleState(
    0,
    0,
    (0.0, 0.0, 0.0),
    (0.0, 0.0, 0.0),
    (1.0, 0.0, 0.0, 0.0),
    False,
    False,
    True,
    FlightMode.HOLD,
    0.9,
)
STATUS = Status(Role.RECEIVER, 1, (0.0, 0.0, -1.0), (0.0, 0.0, 0.0), 0.0, 0, False, False, 0.8)
CONFIG = MissionConfig(deadlines=Deadlines(peer_s=10.0, depart_s=8.0))
WAY_OUT = Anchor((0.0, -2.0, -1.5), 0.0)  # at the height that the tests take off to


@dataclass
class FakeVehicle:
    """Does what it is told, or what ``refuses`` says instead; moves as it is flown unless it is
    ``stuck``.
    """

    now: VehicleState = HOME
    done: list[str] = field(default_factory=list[str])
    refuses: dict[str, VehicleError] = field(default_factory=dict[str, VehicleError])
    stuck: bool = False
    flown: int = 0

    @property
    def state(self) -> VehicleState:
        now_ns = LoopClock(1.0).now_ns()
        return replace(self.now, stamp_ns=now_ns, heartbeat_ns=now_ns)

    async def _do(self, what: str, **changes: Any) -> None:
        self.done.append(what)
        await asyncio.sleep(0.5)
        if what in self.refuses:
            raise self.refuses[what]
        self.now = replace(self.now, **changes)

    async def wait_armable(self, timeout_s: float) -> None:
        await self._do("wait_armable")

    async def arm(self) -> None:
        await self._do("arm", armed=True)

    async def take_off(self, height_m: float, timeout_s: float) -> None:
        await self._do("take_off", in_air=True, position_n_m=(0.0, 0.0, -height_m))

    async def start_offboard(self, first: VelocitySetpoint) -> None:
        self.done.append("start_offboard")
        self.now = replace(self.now, mode=FlightMode.OFFBOARD)

    def fly(self, setpoint: VelocitySetpoint) -> None:
        self.flown += 1
        if not self.stuck:
            step = scale(setpoint.velocity_n_mps, 1.0 / CONFIG.control_hz)
            self.now = replace(self.now, position_n_m=add(self.now.position_n_m, step))

    async def land(self, timeout_s: float) -> None:
        flown = self.flown
        await self._do("land", armed=False, in_air=False, mode=FlightMode.LAND)
        assert self.flown == flown, "setpoints while it lands"


@dataclass
class FakePerception:
    error: CameraError | None = None

    async def view(self, timeout_s: float) -> object:
        if self.error is not None:
            raise self.error
        return object()


@dataclass
class FakeLink:
    counters: LinkCounters = field(default_factory=LinkCounters)
    sent: list[object] = field(default_factory=list[object])

    def send(self, message: object) -> None:
        self.sent.append(message)

    async def receive(self) -> Received:
        return await asyncio.get_running_loop().create_future()  # never


@dataclass
class Recorder:
    phases: list[str] = field(default_factory=list[str])
    notes: list[str] = field(default_factory=list[str])

    def write(self, topic: str, stamp_ns: int, record: Any) -> None:
        if topic == "/phase":
            self.phases.append(record["phase"])
        if topic == "/note":
            self.notes.append(record["note"])


class Bench:
    def __init__(self, rig: Any) -> None:
        self.vehicle, self.perception, self.log = FakeVehicle(), FakePerception(), Recorder()
        self.link = FakeLink()
        parts = cast(Any, (LoopClock(1.0), self.vehicle, self.perception, self.link))
        log = cast(Any, self.log)
        self.session = RoleSession(
            rig, Role.SENDER, CONFIG, log, lambda _: None, asyncio.Event(), parts, random.Random(1)
        )

    def hear_the_peer(self) -> None:
        self.session.peer = STATUS
        self.session.peer_alike = self.session.alike

    def align(self) -> None:
        for nonce in range(1, 5):
            self.session.alignment.on_pong(
                Pong(nonce, nonce * 1000, nonce * 1000, nonce * 1000), nonce * 1000 + 10
            )

    async def in_the_air(self) -> None:
        await take_off(self.session, 1.5)
        await asyncio.sleep(1.0)

    async def down(self, outcome: Outcome | None) -> bool:
        landed = await bring_down(self.session, outcome and MissionEnd(outcome, "seen"), WAY_OUT)
        await self.session.cancel_spawned()
        return landed


def virtual(main: Coroutine[Any, Any, None]) -> None:
    run_virtual(main)


async def ended(step: Coroutine[Any, Any, Any]) -> MissionEnd:
    with pytest.raises(MissionEnd) as caught:
        await step
    return caught.value


# --- preflight


def test_preflight_waits_for_camera_vehicle_peer_and_clocks_and_moves_nothing(rig: Any) -> None:
    async def main() -> None:
        bench, loop = Bench(rig), asyncio.get_running_loop()
        loop.call_later(4.0, bench.hear_the_peer)
        loop.call_later(6.0, bench.align)
        await preflight(bench.session)
        assert loop.time() == pytest.approx(6.0, abs=0.1)
        assert bench.vehicle.done == ["wait_armable"]
        assert bench.log.phases == ["preflight"]

    virtual(main())


@pytest.mark.parametrize(
    ("heard", "outcome"), [(False, Outcome.PEER_LOST), (True, Outcome.CLOCK_FAULT)]
)
def test_preflight_names_what_did_not_come(rig: Any, heard: bool, outcome: Outcome) -> None:
    async def main() -> None:
        bench = Bench(rig)
        if heard:
            bench.hear_the_peer()
        assert (await ended(preflight(bench.session))).outcome is outcome
        assert bench.vehicle.done == ["wait_armable"]

    virtual(main())


@pytest.mark.parametrize("older", [False, True])
def test_a_drone_whose_rig_differs_is_refused_after_it_was_told_what_this_one_has(
    rig: Any, older: bool
) -> None:
    async def main() -> None:
        bench, loop = Bench(rig), asyncio.get_running_loop()
        own = bench.session.alike
        bench.session.peer = STATUS
        bench.session.peer_alike = None if older else replace(own, sides=own.sides % 9 + 1)
        end = await ended(preflight(bench.session))
        assert end.outcome is Outcome.RIGS_DIFFER
        assert ("older" if older else "side_m") in end.detail
        assert 2.0 < loop.time() < 10.0
        assert bench.vehicle.done == ["wait_armable"]

    virtual(main())


def test_what_came_from_a_drone_that_cannot_be_understood_is_told(rig: Any) -> None:
    async def main() -> None:
        bench = Bench(rig)
        bench.session.link.counters.dropped["bad_crc"] = 12
        detail = (await ended(preflight(bench.session))).detail
        assert (
            "not heard (packets came and were dropped, 12 as bad_crc: another version of PATH, or key?)"
            in detail
        )

    virtual(main())


def test_a_part_that_lacks_what_is_needed_is_refused_before_anything_else(rig: Any) -> None:
    async def refused(bench: Bench) -> MissionEnd:
        end = await ended(preflight(bench.session))
        assert bench.vehicle.done == []
        return end

    async def main() -> None:
        bench = Bench(rig)
        setattr(bench.perception, "lacks", frozenset({Capability.RANGE}))  # noqa: B010 (no field of it)
        assert str(await refused(bench)) == "unfit: the sender's perception has no range"
        bench = Bench(rig)
        setattr(bench.vehicle, "lacks", frozenset({Capability.GEOFENCE, Capability.PILOT_OVERRIDE}))  # noqa: B010
        check_capabilities(bench.session)
        bench.session.config = replace(CONFIG, needs=(Capability.GEOFENCE,))
        assert str(await refused(bench)) == "unfit: the sender's vehicle has no geofence"

    virtual(main())


def test_preflight_asks_for_a_frame_first(rig: Any) -> None:
    async def main() -> None:
        bench = Bench(rig)
        bench.perception.error = CameraError("no frame")
        with pytest.raises(CameraError):
            await preflight(bench.session)
        assert bench.vehicle.done == []

    virtual(main())


# --- take-off


def test_take_off_arms_climbs_and_takes_control(rig: Any) -> None:
    async def main() -> None:
        bench = Bench(rig)
        await bench.in_the_air()
        assert bench.vehicle.done == ["arm", "take_off", "start_offboard"]
        assert bench.session.pilot.in_control
        assert bench.vehicle.flown >= 0.9 * CONFIG.control_hz
        assert bench.vehicle.now.position_n_m == pytest.approx((0.0, 0.0, -1.5))
        await bench.session.cancel_spawned()

    virtual(main())


@pytest.mark.parametrize("refused", ["arm", "take_off"])
def test_a_refusal_ends_the_take_off_and_nothing_is_tried_twice(rig: Any, refused: str) -> None:
    async def main() -> None:
        bench = Bench(rig)
        bench.vehicle.refuses[refused] = VehicleError("denied")
        with pytest.raises(VehicleError):
            await take_off(bench.session, 1.5)
        assert bench.vehicle.done.count(refused) == 1
        assert bench.vehicle.done[-1] == refused
        assert bench.vehicle.flown == 0

    virtual(main())


# --- the way down


@pytest.mark.parametrize(
    "outcome",
    [None, Outcome.NO_AGREEMENT, Outcome.TARGET_LOST, Outcome.TOO_CLOSE, Outcome.INTERRUPTED],
)
def test_out_of_the_others_way_then_down(rig: Any, outcome: Outcome | None) -> None:
    async def main() -> None:
        bench = Bench(rig)
        await bench.in_the_air()
        assert await bench.down(outcome)
        assert bench.log.phases == ["take-off", "depart", "land"]
        assert bench.vehicle.done[-1] == "land"
        left = subtract(bench.vehicle.now.position_n_m, WAY_OUT.position_n_m)
        assert norm(left) < 0.4
        assert not bench.session.pilot.in_control

    virtual(main())


def test_a_way_out_through_a_wall_ends_before_it(rig: Any) -> None:
    """What was held at a place behind the wall drifted on until it touched."""

    async def main() -> None:
        bench = Bench(rig)
        corners = ((-3.0, -1.5), (3.0, -1.5), (3.0, 3.0), (-3.0, 3.0))
        bench.session.config = replace(CONFIG, guard=GuardConfig(corners_m=corners, clear_m=0.3))
        bench.session.pilot.fence = bench.session.config.fence
        await bench.in_the_air()
        # where wind, or a velocity that is a little off, had driven it
        bench.vehicle.now = replace(bench.vehicle.now, position_n_m=(0.0, -1.4, -1.5))
        start_s = asyncio.get_running_loop().time()
        assert await bench.down(None)
        assert asyncio.get_running_loop().time() - start_s < CONFIG.deadlines.depart_s
        assert bench.session.config.fence.room_m(0.0, bench.vehicle.now.position_n_m[1]) > 0.2

    virtual(main())


@pytest.mark.parametrize(
    "outcome", [Outcome.GUARD, Outcome.VEHICLE_LOST, Outcome.VEHICLE_REFUSED, Outcome.CRASHED]
)
def test_what_cannot_be_flown_is_landed_where_it_is(rig: Any, outcome: Outcome) -> None:
    async def main() -> None:
        bench = Bench(rig)
        await bench.in_the_air()
        assert await bench.down(outcome)
        assert bench.log.phases == ["take-off", "land"]
        assert bench.vehicle.now.position_n_m == pytest.approx((0.0, 0.0, -1.5))

    virtual(main())


def test_a_pilot_who_took_over_keeps_the_vehicle(rig: Any) -> None:
    async def main() -> None:
        bench = Bench(rig)
        await bench.in_the_air()
        before = bench.vehicle.flown
        assert not await bench.down(Outcome.PILOT_OVERRIDE)
        assert bench.vehicle.done == ["arm", "take_off", "start_offboard"]
        assert bench.vehicle.flown == before
        assert not bench.session.pilot.in_control

    virtual(main())


@pytest.mark.parametrize("leaves", [True, False])
def test_it_waits_with_landing_for_whom_it_tracks_and_not_for_ever(rig: Any, leaves: bool) -> None:
    async def main() -> None:
        bench, loop = Bench(rig), asyncio.get_running_loop()
        await bench.in_the_air()
        bench.vehicle.stuck = True
        begun_s = loop.time()

        def bodies() -> list[Body]:
            north_m = 30.0 if leaves and loop.time() - begun_s > 5.0 else 1.0
            mean = np.array((north_m, 0.0, -0.9, 0.0, 0.0, 0.0))
            motion = Motion(mean, 0.01 * np.eye(6), bench.session.now_ns())
            return [Body(motion, 0.3, 1.75)]

        bench.session.bodies = bodies
        here = Anchor(bench.vehicle.now.position_n_m, 0.0)
        assert await bring_down(bench.session, None, here)
        await bench.session.cancel_spawned()
        assert bench.vehicle.done[-1] == "land"
        waited_s = 5.0 if leaves else CONFIG.deadlines.depart_s
        assert loop.time() - begun_s == pytest.approx(waited_s + 0.5, abs=0.4)
        told = any("short of clear" in each for each in bench.log.notes)
        assert told is not leaves

    virtual(main())


async def flown_through(bench: Bench) -> RoleResult:
    """A whole course of taking off and going home."""

    async def course() -> None:
        await take_off(bench.session, 1.5)

    async def recover(end: MissionEnd | None) -> bool:
        return await bring_down(bench.session, end, WAY_OUT)

    return await fly_course(bench.session, course, recover)


def test_a_pilot_who_takes_the_vehicle_on_its_way_home_is_named(rig: Any) -> None:
    async def main() -> None:
        bench = Bench(rig)

        def take() -> None:
            assert bench.log.phases[-1] == "depart"
            bench.vehicle.now = replace(bench.vehicle.now, mode=FlightMode.OTHER)

        asyncio.get_running_loop().call_later(2.0, take)
        result = await flown_through(bench)
        assert (result.outcome, result.landed) == (Outcome.PILOT_OVERRIDE, False)
        assert "mode is other" in result.detail
        assert bench.vehicle.done[-1] == "start_offboard"
        told = [each.ended for each in bench.link.sent if isinstance(each, Status)]
        assert told[-5:] == [Outcome.PILOT_OVERRIDE.exit_code] * 5  # the other drone flies near it

    virtual(main())


def test_a_pilot_who_ends_the_landing_is_named_too(rig: Any) -> None:
    async def main() -> None:
        bench = Bench(rig)
        bench.vehicle.refuses["land"] = TakenOver("landing ended by a change to mode other")
        result = await flown_through(bench)
        assert (result.outcome, result.landed) == (Outcome.PILOT_OVERRIDE, False)
        assert result.detail == "landing ended by a change to mode other"

    virtual(main())


def test_a_pilot_who_takes_the_vehicle_after_the_mission_failed_is_named_with_what_it_failed_of(
    rig: Any,
) -> None:
    async def main() -> None:
        bench = Bench(rig)

        async def course() -> None:
            await take_off(bench.session, 1.5)
            raise MissionEnd(Outcome.NO_AGREEMENT, "the views did not agree")

        async def recover(end: MissionEnd | None) -> bool:
            return await bring_down(bench.session, end, WAY_OUT)

        def take() -> None:
            assert bench.log.phases[-1] == "depart"
            bench.vehicle.now = replace(bench.vehicle.now, mode=FlightMode.OTHER)

        asyncio.get_running_loop().call_later(2.0, take)
        result = await fly_course(bench.session, course, recover)
        assert (result.outcome, result.landed) == (Outcome.PILOT_OVERRIDE, False)
        assert "mode is other" in result.detail
        assert "the views did not agree" in result.detail

    virtual(main())


def test_what_is_disarmed_a_moment_after_it_changed_its_mode_on_the_ground_is_down(
    rig: Any,
) -> None:
    async def main() -> None:
        bench = Bench(rig)
        await bench.in_the_air()
        bench.vehicle.now = replace(bench.vehicle.now, in_air=False)

        def disarm() -> None:
            bench.vehicle.now = replace(bench.vehicle.now, armed=False)

        asyncio.get_running_loop().call_later(1.5, disarm)
        assert await bench.down(Outcome.PILOT_OVERRIDE)

    virtual(main())


def test_what_a_pilot_has_disarmed_on_the_ground_is_down(rig: Any) -> None:
    async def main() -> None:
        bench = Bench(rig)
        await bench.in_the_air()
        bench.vehicle.now = replace(bench.vehicle.now, armed=False, in_air=False)
        assert await bench.down(Outcome.PILOT_OVERRIDE)

    virtual(main())


def test_what_somebody_lands_already_is_left_to_it_and_the_guard_is_told(rig: Any) -> None:
    async def main() -> None:
        bench = Bench(rig)
        bench.vehicle.now = replace(
            bench.vehicle.now, armed=True, in_air=True, mode=FlightMode.LAND
        )
        landing = asyncio.create_task(bench.down(Outcome.VEHICLE_REFUSED))
        await asyncio.sleep(1.0)
        assert bench.session.guarding.beat().script is Script.LET_GO
        bench.vehicle.now = replace(bench.vehicle.now, armed=False, in_air=False)
        assert await landing
        assert bench.vehicle.done == []

    virtual(main())


def test_what_never_left_the_ground_is_down(rig: Any) -> None:
    async def main() -> None:
        bench = Bench(rig)
        assert await bench.down(Outcome.PEER_LOST)
        assert bench.vehicle.done == []
        assert bench.log.phases == []

    virtual(main())


def test_departing_takes_no_longer_than_its_deadline(rig: Any) -> None:
    async def main() -> None:
        bench = Bench(rig)
        await bench.in_the_air()
        bench.vehicle.stuck = True
        start_s = asyncio.get_running_loop().time()
        assert await bench.down(None)
        assert asyncio.get_running_loop().time() - start_s == pytest.approx(
            CONFIG.deadlines.depart_s + 0.5, abs=0.2
        )

    virtual(main())


def test_a_guard_that_trips_on_the_way_out_lands_at_once(rig: Any) -> None:
    async def main() -> None:
        bench = Bench(rig)
        await bench.in_the_air()
        bench.vehicle.stuck = True
        bench.vehicle.now = replace(bench.vehicle.now, battery=0.1)
        start_s = asyncio.get_running_loop().time()
        assert await bench.down(None)
        assert asyncio.get_running_loop().time() - start_s < 1.0

    virtual(main())


def test_a_landing_that_is_not_confirmed_is_said(rig: Any) -> None:
    async def main() -> None:
        bench = Bench(rig)
        await bench.in_the_air()
        bench.vehicle.refuses["land"] = VehicleError("still armed after 40 s")
        assert not await bench.down(None)
        assert bench.session.shown.note == "landing not confirmed: still armed after 40 s"

    virtual(main())
