"""A session's pump, report, waits, images and what it gives up on a slow computer."""

from __future__ import annotations

import asyncio
import time
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from drivers.stages import Stages
from flight.config import MissionConfig
from flight.outcome import MissionEnd, Outcome
from flight.phases import Phase
from hil.harness.virtual_time import run_virtual
from missions.fly.leg.beside import keep_up, log_lateness
from path.messages import Message, Ping, Pong, Role, Status, Target
from path.protocol.values import TakeResponsibility
from tests.missions.fly.leg.session_bench import STATE, Bench, for_ever, virtual

TARGET = Target(1, 1, 1, 1, 1, (0.0, 0.0, 1.0), (0.0, -1.0, 0.0), 0.01)
STATUS = Status(Role.RECEIVER, 1, (0.0, 0.0, -1.0), (0.0, 0.0, 0.0), 0.0, 3, False, True, 0.8)


# --- waiting


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
            (stamp_ns, record["position_n_m"])
            for topic, stamp_ns, record in bench.log.entries
            if topic == "/state"
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
            await Bench(rig).session.until(
                lambda: False, 5.0, Outcome.PEER_LOST, "the other drone was not heard"
            )
        assert caught.value.outcome is Outcome.PEER_LOST
        assert caught.value.detail == "the other drone was not heard within 5 s"
        assert asyncio.get_running_loop().time() == pytest.approx(5.0, abs=0.1)

    virtual(main())


# --- the pump and the report


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
        expected = Status(
            Role.SENDER,
            1_000_000_000,
            STATE.position_n_m,
            STATE.velocity_n_mps,
            0.0,
            8,
            True,
            True,
            0.9,
        )
        assert status == expected

    virtual(main())


def test_what_both_must_have_alike_is_said_but_while_they_verify(rig: Any) -> None:
    async def main() -> None:
        bench = Bench(rig)
        bench.session.spawn(bench.session.report())
        await asyncio.sleep(0.05)
        bench.session.enter(Phase.VERIFY)
        await asyncio.sleep(0.1)
        await bench.session.cancel_spawned()
        first, second = bench.link.of(Status)
        assert (first.alike, second.alike) == (bench.session.alike, None)

    virtual(main())


def test_what_the_other_drone_has_is_remembered_while_it_does_not_say_it(rig: Any) -> None:
    async def main() -> None:
        bench = Bench(rig)
        bench.session.spawn(bench.session.pump())
        own = bench.session.alike
        for message in (STATUS, replace(STATUS, alike=own), STATUS):
            bench.link.waiting.put_nowait(message)
        await asyncio.sleep(0.05)
        assert (bench.session.peer, bench.session.peer_alike) == (STATUS, own)
        await bench.session.cancel_spawned()

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
            bench.session.alignment.on_pong(
                Pong(nonce, at_ns, at_ns + 1000, at_ns + 1000), at_ns + 2000
            )
        assert bench.session.alignment.ready
        await asyncio.sleep(5.0)
        await bench.session.cancel_spawned()
        assert len(bench.link.of(Ping)) - before == pytest.approx(5, abs=1)
        assert len(bench.link.of(Status)) == pytest.approx(80, abs=1)
        nonces = [ping.nonce for ping in bench.link.of(Ping)]
        assert nonces == sorted(set(nonces))

    virtual(main())


@pytest.mark.parametrize(
    ("role", "hz", "times"),
    [
        (Role.SENDER, 10.0, [0.0, 0.2, 0.4, 0.6, 0.8, 1.0]),
        (Role.SENDER, 4.0, [0.0, 0.25, 0.5, 0.75, 1.0]),
        (Role.RECEIVER, 10.0, [0.0, 0.2, 0.4, 0.6, 0.8, 1.0]),
    ],
)
def test_the_console_is_told_at_once_and_five_times_a_second_as_far_as_statuses_go(
    rig: Any, role: Role, hz: float, times: list[float]
) -> None:
    async def main() -> None:
        config = MissionConfig(status_hz=hz, receiver_status_hz=hz, ping_hz=1.0)
        bench = Bench(rig, config, role=role)
        begun_ns = bench.session.now_ns()
        bench.session.spawn(bench.session.report())
        await asyncio.sleep(1.05)
        await bench.session.cancel_spawned()
        shown_s = [(each.stamp_ns - begun_ns) * 1e-9 for each in bench.shown]
        assert shown_s == pytest.approx(times, abs=0.01)
        logged_s = [
            (stamp_ns - begun_ns) * 1e-9
            for topic, stamp_ns, _ in bench.log.entries
            if topic == "/link"
        ]
        assert logged_s == pytest.approx([0.0, 1.0], abs=0.01)  # of the link once a second
        nonces = [ping.nonce for ping in bench.link.of(Ping)]
        assert nonces == list(range(1, len(nonces) + 1))

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
        assert (
            len(told) == 2
            and "ALARM: 25," in told[0]
            and told[1] == "the flood on the link is over"
        )

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
        # the same frame
        bench.session.frames.log_image(cast(Any, FakeView(2_020_000_000, pixels)), wanted=True)
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


# --- a computer that does not keep up


def test_pictures_go_first_but_not_the_wanted_ones(rig: Any) -> None:
    view = cast(
        Any, SimpleNamespace(stamp_ns=5_000_000_000, image=lambda: np.zeros((2, 2, 3), np.uint8))
    )

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
        beside = asyncio.create_task(keep_up(bench.session))
        async with asyncio.timeout(120.0):
            while not bench.log.of("/shed"):
                time.sleep(0.02)  # noqa: ASYNC251 (that is what is tried)
                await asyncio.sleep(0)
        beside.cancel()
        return bench

    bench = asyncio.run(busy())
    (shed,) = bench.log.of("/shed")
    assert (shed["what"], shed["gone"]) == ("picture log", True)
    assert "gives up picture log" in bench.session.shown.note


def test_a_program_whose_loop_stood_still_says_so_with_what_the_computer_took_of_that(
    rig: Any,
) -> None:
    async def stand() -> Bench:
        bench = Bench(rig, stages=Stages())
        beside = asyncio.create_task(log_lateness(bench.session))
        await asyncio.sleep(0.1)
        time.sleep(0.3)  # noqa: ASYNC251 (that is what is tried)
        await asyncio.sleep(0.1)
        beside.cancel()
        return bench

    longest = max(asyncio.run(stand()).log.of("/late"), key=lambda record: record["loop_ns"])
    assert longest["loop_ns"] >= 0.25e9
    assert {"since_ns", "waited_ns", "beside_ns", "stolen_ns", "disk_ns"} <= set(longest)
    assert longest["disk_ns"] < 0.1e9  # it slept by itself


def test_in_virtual_time_nothing_is_late(rig: Any) -> None:
    async def fly() -> Bench:
        bench = Bench(rig)
        await asyncio.wait_for(keep_up(bench.session), 1.0)  # returns at once
        await asyncio.wait_for(log_lateness(bench.session), 1.0)
        return bench

    log = run_virtual(fly()).log
    assert log.of("/shed") == log.of("/late") == []
