"""The end of a session: what ends a mission decides its outcome, and the recovery always runs.

Whatever fails in the recovery is told, not raised.
"""

from __future__ import annotations

import asyncio
import random
import time
from collections.abc import Awaitable, Callable, Coroutine
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any, TypeVar, cast

import numpy as np
import pytest

from drivers.interfaces import (
    CameraError,
    FlightMode,
    LinkCounters,
    LinkError,
    PartError,
    Received,
    VehicleError,
    VehicleState,
)
from drivers.stages import Stages
from flight.config import MissionConfig
from flight.harness.flights import Progress, RoleResult
from flight.outcome import MissionEnd, Outcome
from flight.phases import Phase
from hil.harness.virtual_time import run_virtual
from missions import rig_library
from missions.leg.course import fly_course
from missions.leg.ends import as_end
from missions.leg.session import RoleSession
from path.messages import Message, Ping, Pong, Role, Status, Target
from path.protocol.values import TakeResponsibility

T = TypeVar("T")
STATE = VehicleState(
    0, 0, (1.0, 2.0, -1.5), (0.1, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), True, True, True, FlightMode.OFFBOARD, 0.9
)
TARGET = Target(1, 1, 1, 1, 1, (0.0, 0.0, 1.0), (0.0, -1.0, 0.0), 0.01)
STATUS = Status(Role.RECEIVER, 1, (0.0, 0.0, -1.0), (0.0, 0.0, 0.0), 0.0, 3, False, True, 0.8)


@pytest.fixture(scope="module")
def rig() -> Any:
    return rig_library.load("sim")


@dataclass
class Clock:
    def now_ns(self) -> int:
        return round((asyncio.get_running_loop().time() + 1.0) * 1e9)


@dataclass
class FakeLink:
    counters: LinkCounters = field(default_factory=LinkCounters)
    sent: list[tuple[float, Message]] = field(default_factory=list[tuple[float, Message]])
    waiting: asyncio.Queue[Message | Exception] = field(default_factory=asyncio.Queue[Message | Exception])

    def send(self, message: Message) -> None:
        self.sent.append((asyncio.get_running_loop().time(), message))
        self.counters.bytes_sent += 100

    async def receive(self) -> Received:
        message = await self.waiting.get()
        if isinstance(message, Exception):
            raise message
        return Received(message, Clock().now_ns())

    def of(self, kind: type[T]) -> list[T]:
        return [message for _, message in self.sent if isinstance(message, kind)]


@dataclass
class FakeVehicle:
    state: VehicleState = STATE


@dataclass
class Recorder:
    entries: list[tuple[str, int, dict[str, Any]]] = field(default_factory=list[tuple[str, int, dict[str, Any]]])
    images: list[int] = field(default_factory=list[int])

    def write(self, topic: str, stamp_ns: int, record: Any) -> None:
        self.entries.append((topic, stamp_ns, dict(record)))

    def image(self, topic: str, stamp_ns: int, image: Any) -> None:
        self.images.append(stamp_ns)

    def of(self, topic: str) -> list[dict[str, Any]]:
        return [record for name, _, record in self.entries if name == topic]


class Bench:
    """A session on fakes, and what it was seen to do."""

    def __init__(
        self, rig: Any, config: MissionConfig | None = None, role: Role = Role.SENDER, stages: Stages | None = None
    ) -> None:
        self.link, self.log, self.vehicle = FakeLink(), Recorder(), FakeVehicle()
        self.shown: list[Progress] = []
        self.stop = asyncio.Event()
        parts = cast(Any, (Clock(), self.vehicle, None, self.link))
        self.session = RoleSession(
            rig,
            role,
            config or MissionConfig(),
            self.log,
            self.shown.append,
            self.stop,
            parts,
            random.Random(1),
            stages=stages,
        )
        self.recovered: list[MissionEnd | None] = []
        self.landed = True
        self.fails: Exception | None = None

    async def recover(self, end: MissionEnd | None) -> bool:
        self.recovered.append(end)
        await asyncio.sleep(1.0)
        if self.fails is not None:
            raise self.fails
        return self.landed

    async def fly(self, course: Callable[[], Awaitable[None]]) -> RoleResult:
        complaints: list[dict[str, Any]] = []
        asyncio.get_running_loop().set_exception_handler(lambda _, context: complaints.append(context))
        result = await fly_course(self.session, course, self.recover)
        assert complaints == []
        assert len(asyncio.all_tasks()) == 1  # nothing goes on after the end
        return result


def virtual(main: Coroutine[Any, Any, None]) -> None:
    run_virtual(main)


async def good() -> None:
    await asyncio.sleep(2.0)


async def for_ever() -> None:
    await asyncio.sleep(1e6)


# --- ends --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("error", "outcome"),
    [
        (CameraError("no frame for 0.8 s"), Outcome.CAMERA_LOST),
        (VehicleError("arming denied"), Outcome.VEHICLE_REFUSED),
        (LinkError("socket closed"), Outcome.PEER_LOST),
        (MissionEnd(Outcome.TARGET_LOST, "gone"), Outcome.TARGET_LOST),
    ],
)
def test_every_error_of_a_part_is_a_named_end(error: Exception, outcome: Outcome) -> None:
    end = as_end(error)
    assert end.outcome is outcome
    assert str(error) in (end.detail, str(end))


@pytest.mark.parametrize("error", [KeyError("x"), AssertionError(), ZeroDivisionError("division by zero")])
def test_an_error_nobody_foresaw_is_a_crash_and_printed(error: Exception, capsys: pytest.CaptureFixture[str]) -> None:
    end = as_end(error)
    assert end.outcome is Outcome.CRASHED
    assert type(error).__name__ in end.detail
    assert type(error).__name__ in capsys.readouterr().err


def test_a_course_that_comes_to_its_end_is_committed_and_recovered(rig: Any) -> None:
    async def main() -> None:
        bench = Bench(rig)
        bench.session.set_claim(TakeResponsibility())
        assert await bench.fly(good) == RoleResult(Role.SENDER, Outcome.COMMITTED, "", True, True)
        assert bench.recovered == [None]
        assert bench.log.of("/outcome") == [{"outcome": "committed", "detail": "", "responsible": True, "landed": True}]
        assert bench.session.phase is Phase.DONE

    virtual(main())


@pytest.mark.parametrize("error", [MissionEnd(Outcome.MARKER_LOST, "not seen"), CameraError("no frame")])
def test_a_course_that_fails_is_recovered_from_by_its_end(rig: Any, error: Exception) -> None:
    async def main() -> None:
        async def course() -> None:
            await asyncio.sleep(1.0)
            raise error

        bench = Bench(rig)
        result = await bench.fly(course)
        assert result.outcome is as_end(error).outcome
        assert result.landed
        assert [end.outcome for end in bench.recovered if end] == [result.outcome]
        assert bench.log.of("/note")[0] == {"note": str(as_end(error))}

    virtual(main())


def test_what_fails_beside_the_course_ends_it(rig: Any) -> None:
    cancelled: list[bool] = []

    async def main() -> None:
        bench = Bench(rig)

        async def watch() -> None:
            await asyncio.sleep(0.5)
            raise MissionEnd(Outcome.TARGET_LOST, "gone")

        async def course() -> None:
            bench.session.spawn(watch())
            try:
                await asyncio.sleep(1e6)
            except asyncio.CancelledError:
                cancelled.append(True)
                raise

        result = await bench.fly(course)
        assert (result.outcome, result.detail) == (Outcome.TARGET_LOST, "gone")

    virtual(main())
    assert cancelled == [True]


def test_the_first_failure_is_the_cause_later_ones_are_not(rig: Any) -> None:
    async def main() -> None:
        bench = Bench(rig)

        async def fail(after_s: float, outcome: Outcome) -> None:
            await asyncio.sleep(after_s)
            raise MissionEnd(outcome, "seen")

        bench.session.spawn(fail(1.0, Outcome.GUARD))
        bench.session.spawn(fail(1.5, Outcome.CAMERA_LOST))  # while it is brought down
        bench.session.spawn(fail(0.6, Outcome.MARKER_LOST))
        assert (await bench.fly(for_ever)).outcome is Outcome.MARKER_LOST
        assert len(bench.recovered) == 1

    virtual(main())


def test_being_told_to_stop_lands(rig: Any) -> None:
    async def main() -> None:
        bench = Bench(rig)
        asyncio.get_running_loop().call_later(3.0, bench.stop.set)
        result = await bench.fly(for_ever)
        assert result.outcome is Outcome.INTERRUPTED
        assert result.landed
        assert [end.outcome for end in bench.recovered if end] == [Outcome.INTERRUPTED]

    virtual(main())


def test_a_broken_link_ends_the_mission(rig: Any) -> None:
    async def main() -> None:
        bench = Bench(rig)
        bench.link.waiting.put_nowait(LinkError("socket closed"))
        assert (await bench.fly(for_ever)).outcome is Outcome.PEER_LOST

    virtual(main())


@pytest.mark.parametrize(
    "failure", [VehicleError("landing not confirmed"), MissionEnd(Outcome.GUARD, "fence"), PartError("gone")]
)
@pytest.mark.parametrize("course", [good, for_ever])
def test_a_failure_in_the_recovery_is_told_not_raised(
    rig: Any, failure: Exception, course: Callable[[], Awaitable[None]]
) -> None:
    async def main() -> None:
        bench = Bench(rig)
        bench.fails = failure
        asyncio.get_running_loop().call_later(3.0, bench.stop.set)
        result = await bench.fly(course)
        assert result.outcome is (Outcome.COMMITTED if course is good else Outcome.INTERRUPTED)
        assert not result.landed
        assert f"not landed by the script: {failure}" in [record["note"] for record in bench.log.of("/note")]
        assert bench.log.of("/outcome")[0]["landed"] is False

    virtual(main())


def test_statuses_go_on_until_the_vehicle_is_down(rig: Any) -> None:
    async def main() -> None:
        bench = Bench(rig)
        await bench.fly(good)
        times = [time_s for time_s, message in bench.link.sent if isinstance(message, Status)]
        assert times[-1] >= 2.9 - 0.1  # the course took 2 s, the recovery one more

    virtual(main())


# --- waiting -----------------------------------------------------------------------------------------------------


def test_the_vehicles_state_is_logged_once_for_each_report(rig: Any) -> None:
    async def main() -> None:
        bench = Bench(rig)

        async def course() -> None:
            await asyncio.sleep(0.25)  # no position yet
            bench.vehicle.state = replace(STATE, stamp_ns=7)
            await asyncio.sleep(0.5)
            bench.vehicle.state = replace(STATE, stamp_ns=9, position_n_m=(1.5, 2.0, -1.5))
            await asyncio.sleep(0.5)

        await bench.fly(course)
        logged = [
            (stamp_ns, record["position_n_m"]) for topic, stamp_ns, record in bench.log.entries if topic == "/state"
        ]
        assert logged == [(7, (1.0, 2.0, -1.5)), (9, (1.5, 2.0, -1.5))]

    virtual(main())


def test_a_wait_ends_when_its_condition_comes_true(rig: Any) -> None:
    async def main() -> None:
        bench, loop = Bench(rig), asyncio.get_running_loop()
        await bench.session.until(lambda: loop.time() > 2.0, 5.0, Outcome.PEER_LOST, "nobody")
        assert loop.time() == pytest.approx(2.0, abs=0.1)

    virtual(main())


def test_a_wait_that_is_over_is_a_named_end(rig: Any) -> None:
    async def main() -> None:
        with pytest.raises(MissionEnd) as caught:
            await Bench(rig).session.until(lambda: False, 5.0, Outcome.PEER_LOST, "the other drone was not heard")
        assert caught.value.outcome is Outcome.PEER_LOST
        assert caught.value.detail == "the other drone was not heard within 5 s"
        assert asyncio.get_running_loop().time() == pytest.approx(5.0, abs=0.1)

    virtual(main())


# --- the pump and the report -------------------------------------------------------------------------------------


def test_the_pump_answers_pings_keeps_the_status_and_passes_on_the_rest(rig: Any) -> None:
    async def main() -> None:
        bench = Bench(rig)
        passed: list[Message] = []
        statuses: list[Status] = []
        bench.session.on_message = lambda received: passed.append(received.message)
        bench.session.on_status = statuses.append
        assert bench.session.peer is None
        bench.session.spawn(bench.session.pump())
        await asyncio.sleep(2.0)
        for message in (Ping(7, 5), STATUS, TARGET, Pong(1, 0, 0, 0)):
            bench.link.waiting.put_nowait(message)
        await asyncio.sleep(0.5)
        await bench.session.cancel_spawned()
        assert passed == [TARGET]
        assert statuses == [STATUS] and bench.session.peer == STATUS
        (pong,) = bench.link.of(Pong)
        assert (pong.nonce, pong.ping_sent_ns) == (7, 5)
        assert pong.received_ns <= pong.sent_ns == 3_000_000_000
        assert bench.session.peer_silence_s() == pytest.approx(0.5)

    virtual(main())


def test_the_status_says_what_the_vehicle_says(rig: Any) -> None:
    async def main() -> None:
        bench = Bench(rig)
        bench.session.observing = True
        bench.session.set_claim(TakeResponsibility())
        bench.session.enter(Phase.VERIFY)
        bench.session.spawn(bench.session.report())
        await asyncio.sleep(0.05)
        await bench.session.cancel_spawned()
        (status,) = bench.link.of(Status)
        expected = Status(Role.SENDER, 1_000_000_000, STATE.position_n_m, STATE.velocity_n_mps, 0.0, 8, True, True, 0.9)
        assert status == expected

    virtual(main())


def test_statuses_and_pings_are_paced(rig: Any) -> None:
    async def main() -> None:
        bench = Bench(rig, MissionConfig(status_hz=10.0, ping_hz=1.0))
        bench.session.spawn(bench.session.report())
        await asyncio.sleep(3.0)
        before = len(bench.link.of(Ping))
        assert before == pytest.approx(30, abs=1)  # with every status until the clocks are known
        for nonce, ping in enumerate(bench.link.of(Ping)[:5], 1):
            at_ns = ping.sent_ns
            bench.session.alignment.on_pong(Pong(nonce, at_ns, at_ns + 1000, at_ns + 1000), at_ns + 2000)
        assert bench.session.alignment.ready
        await asyncio.sleep(5.0)
        await bench.session.cancel_spawned()
        assert len(bench.link.of(Ping)) - before == pytest.approx(5, abs=1)
        assert len(bench.link.of(Status)) == pytest.approx(80, abs=1)
        nonces = [ping.nonce for ping in bench.link.of(Ping)]
        assert nonces == sorted(set(nonces))

    virtual(main())


def test_a_stepped_clock_ends_the_mission(rig: Any) -> None:
    async def main() -> None:
        bench = Bench(rig)

        async def step() -> None:
            alignment = bench.session.alignment
            for nonce in range(1, 20):
                stepped_ns = 0 if nonce < 5 else 2_000_000_000
                at_ns = bench.session.now_ns()
                peer_ns = at_ns + 1000 + stepped_ns
                alignment.on_pong(Pong(nonce, at_ns, peer_ns, peer_ns), at_ns + 2000)
                await asyncio.sleep(0.5)

        bench.session.spawn(step())
        assert (await bench.fly(for_ever)).outcome is Outcome.CLOCK_FAULT

    virtual(main())


def test_the_console_sees_phase_count_and_traffic(rig: Any) -> None:
    async def main() -> None:
        bench = Bench(rig)
        bench.session.shown.count, bench.session.shown.iou = 42, 0.7
        bench.session.enter(Phase.VERIFY, "go")
        bench.session.spawn(bench.session.report())
        await asyncio.sleep(5.0)
        await bench.session.cancel_spawned()
        newest = bench.shown[-1]
        assert (newest.role, newest.phase, newest.note) == (Role.SENDER, "verify", "go")
        assert (newest.count, newest.needed, newest.iou) == (42, rig.method.needed_pairs, 0.7)
        sent_per_s = len(bench.link.sent) * 100 / 5.0
        assert newest.link_bytes_per_s == pytest.approx(sent_per_s, rel=0.15)

    virtual(main())


def test_the_crew_is_told_of_a_flood_while_it_lasts_and_the_mission_goes_on(rig: Any) -> None:
    async def main() -> None:
        bench = Bench(rig)
        bench.session.spawn(bench.session.report())
        for second in range(12):
            await asyncio.sleep(1.0)
            if second in (2, 3, 4):
                bench.link.counters.dropped["flooded"] = 25_000 * (second - 1)
        await bench.session.cancel_spawned()
        told = [record["note"] for record in bench.log.of("/note")]
        assert len(told) == 2 and "ALARM: 25," in told[0] and told[1] == "the flood on the link is over"

    virtual(main())


def test_images_are_logged_at_their_rate_and_when_wanted(rig: Any) -> None:
    @dataclass
    class FakeView:
        stamp_ns: int
        pixels: Any

        def image(self) -> Any:
            return self.pixels

    async def main() -> None:
        bench = Bench(rig, MissionConfig(image_hz=2.0))
        pixels = np.zeros((2, 2, 3), np.uint8)
        for k in range(101):
            bench.session.frames.log_image(cast(Any, FakeView(k * 20_000_000, pixels)))
        assert bench.log.images == [0, 500_000_000, 1_000_000_000, 1_500_000_000, 2_000_000_000]
        bench.session.frames.log_image(cast(Any, FakeView(2_020_000_000, pixels)), wanted=True)
        bench.session.frames.log_image(cast(Any, FakeView(2_020_000_000, pixels)), wanted=True)  # the same frame
        bench.session.frames.log_image(cast(Any, FakeView(2_040_000_000, None)), wanted=True)
        assert bench.log.images[5:] == [2_020_000_000]

    virtual(main())


def test_without_a_rate_only_wanted_images_are_logged(rig: Any) -> None:
    @dataclass
    class FakeView:
        stamp_ns: int

        def image(self) -> Any:
            return np.zeros((2, 2, 3), np.uint8)

    async def main() -> None:
        bench = Bench(rig, MissionConfig(image_hz=0.0))
        for k in range(3):
            bench.session.frames.log_image(cast(Any, FakeView(k * 1_000_000_000)), wanted=k == 1)
        assert bench.log.images == [1_000_000_000]

    virtual(main())


# --- a computer that does not keep up ----------------------------------------------------------------------------


def test_pictures_go_first_but_not_the_wanted_ones(rig: Any) -> None:
    view = cast(Any, SimpleNamespace(stamp_ns=5_000_000_000, image=lambda: np.zeros((2, 2, 3), np.uint8)))

    async def look() -> list[int]:
        bench = Bench(rig)
        bench.session.frames.shedding.gone = 1
        bench.session.frames.log_image(view)
        bench.session.frames.log_image(view, wanted=True)
        return bench.log.images

    assert asyncio.run(look()) == [view.stamp_ns]


def test_a_program_that_is_always_at_work_says_what_it_gives_up(rig: Any) -> None:
    """In real time: the loop is kept busy, as by frames that take too long."""

    async def busy() -> Bench:
        bench = Bench(rig, stages=Stages())
        beside = asyncio.create_task(bench.session.keep_up())
        async with asyncio.timeout(120.0):
            while not bench.log.of("/shed"):
                time.sleep(0.02)  # noqa: ASYNC251 (that is what is tried)
                await asyncio.sleep(0)
        beside.cancel()
        return bench

    bench = asyncio.run(busy())
    assert not bench.session.frames.shedding.thorough  # what a search takes is not known
    (shed,) = bench.log.of("/shed")
    assert (shed["what"], shed["gone"]) == ("picture log", True)
    assert "gives up picture log" in bench.session.shown.note


def test_in_virtual_time_nothing_is_late(rig: Any) -> None:
    async def fly() -> Bench:
        bench = Bench(rig)
        await asyncio.wait_for(bench.session.keep_up(), 1.0)  # returns at once
        return bench

    assert run_virtual(fly()).log.of("/shed") == []
