"""What runs beside a course: the guard's beat, the battery's news, the frames that are recorded,
the traffic shown.
"""

from __future__ import annotations

import asyncio
import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import pytest

from drivers.mavlink.guard.interfaces import NOWHERE, Beat, GuardAnswer, Hand, Script
from flight.config import MissionConfig
from flight.outcome import MissionEnd, Outcome
from flight.phases import Phase
from missions.fly.leg.beside import BatteryNews
from missions.fly.leg.frames import Frames
from path.messages import Role, Status
from tests.doubles import LoopClock
from tests.missions.fly.leg.session_bench import STATE, Bench, Recorder, virtual

PEER = Status(Role.RECEIVER, 1, (4.0, 3.0, -1.5), (0.0, 0.0, 0.0), 0.0, 3, False, True, 0.8)
S = 1_000_000_000


@pytest.mark.parametrize(("silent_s", "known"), [(0.0, True), (0.99, True), (1.0, False)])
def test_the_guard_is_told_where_the_other_drone_is_for_a_second_after_it_was_heard(
    rig: Any, silent_s: float, known: bool
) -> None:
    async def main() -> None:
        session = Bench(rig).session
        assert session.guarding.beat().peer_n_m is NOWHERE
        session.peer = PEER
        session.peer_heard_ns = session.now_ns() - round(silent_s * S)
        assert (session.guarding.beat().peer_n_m is not NOWHERE) is known

    virtual(main())


def test_the_guard_is_told_who_flies(rig: Any) -> None:
    async def main() -> None:
        session = Bench(rig).session
        session.guarding.set_script(Script.CLIMB)
        assert session.guarding.beat().script is Script.CLIMB
        pilot: Any = SimpleNamespace(override="", in_control=True, setpoints=7)
        session.pilot = pilot
        assert (session.guarding.beat().script, session.guarding.beat().setpoints) == (
            Script.CONTROL,
            7,
        )
        pilot.override = "mode is other"
        assert session.guarding.beat().script is Script.LET_GO

    virtual(main())


def test_what_the_guard_ignores_is_told_once_and_a_guard_that_has_the_vehicle_ends_the_course(
    rig: Any,
) -> None:
    async def main() -> None:
        bench = Bench(rig)
        session = bench.session
        said: list[GuardAnswer] = [GuardAnswer(True, Hand.SCRIPT, "", "beats of another")]
        beats: list[float] = []

        def check() -> None:
            if len(beats) > 20:
                raise MissionEnd(Outcome.GUARD, "taken")

        def beat(_told: Beat) -> None:
            beats.append(asyncio.get_running_loop().time())

        guard: Any = SimpleNamespace(beat=beat, look=lambda: said[0], check=check)
        session.guarding.guard = guard
        session.guarding.script = Script.IDLE
        keeping = asyncio.create_task(session.guarding.keep())
        await asyncio.sleep(2.0)
        assert not session.ended.done()  # nothing flies
        assert [record["note"] for record in bench.log.of("/note")] == [
            "ALARM: the guard ignores beats of another"
        ]
        assert len(beats) == pytest.approx(40, abs=1)
        session.guarding.script = Script.CLIMB
        await asyncio.sleep(0.1)
        assert session.ended.done() and session.ended.result().outcome is Outcome.GUARD
        await asyncio.sleep(0.2)  # the course ends once
        keeping.cancel()

    virtual(main())


def test_a_battery_that_is_not_told_any_more_is_told_once_and_again_when_it_is(rig: Any) -> None:
    async def main() -> None:
        bench = Bench(rig)
        news = BatteryNews(bench.session)
        now_ns = bench.session.now_ns()

        def look(ago_s: float | None, armed: bool = True, level: float = 0.63) -> list[str]:
            told_ns = None if ago_s is None else now_ns - round(ago_s * S)
            before = len(bench.log.of("/note"))
            news.look(replace(STATE, armed=armed, battery=level, battery_ns=told_ns))
            return [record["note"] for record in bench.log.of("/note")[before:]]

        assert look(None) == look(3.0) == look(60.0, armed=False) == []
        (told,) = look(3.1)
        assert told.startswith(
            "ALARM: the battery's level is not told any more: 63 % is believed for 10 s"
        )
        assert look(4.0) == []
        assert look(0.1) == ["the battery's level is told again"]
        (unknown,) = look(3.1, level=math.nan)
        assert "an unknown level is believed" in unknown

    virtual(main())


class Film(Recorder):
    """A log that takes frames too."""

    def __init__(self) -> None:
        super().__init__()
        self.frames: list[object] = []

    def frame(self, frame: object) -> None:
        self.frames.append(frame)


@pytest.mark.parametrize(
    ("record", "films", "recorded"),
    [("all", True, True), ("all", False, False), ("some", True, False)],
)
def test_frames_are_recorded_where_the_rig_says_so_and_the_log_can(
    rig: Any, record: str, films: bool, recorded: bool
) -> None:
    async def main() -> None:
        log = Film() if films else Recorder()
        view = SimpleNamespace(stamp_ns=5, frame_id=1, frame="a frame")

        async def give(timeout_s: float) -> object:
            assert timeout_s == 0.8
            return view

        config = replace(MissionConfig(), record=cast(Any, record))
        frames = Frames(
            cast(Any, SimpleNamespace(view=give)), LoopClock(1.0), config, cast(Any, log)
        )
        assert frames.recorded is recorded
        assert await frames.view(0.8) is view
        if isinstance(log, Film):
            assert log.frames == (["a frame"] if recorded else [])

    virtual(main())


def test_a_busy_computer_waits_before_it_takes_its_next_frame(rig: Any) -> None:
    async def main() -> None:
        took: list[tuple[int, int, int]] = []

        async def give(_timeout_s: float) -> object:
            return SimpleNamespace(stamp_ns=5, frame_id=1)

        frames = Frames(
            cast(Any, SimpleNamespace(view=give)),
            LoopClock(1.0),
            MissionConfig(),
            cast(Any, Recorder()),
        )

        def until_next_s(_now_ns: int) -> float:
            return 0.3

        def took_up(*what: int) -> None:
            took.append((what[0], what[1], what[2]))

        cast(Any, frames).shedding = SimpleNamespace(until_next_s=until_next_s, took=took_up)
        await frames.view(1.0)
        assert asyncio.get_running_loop().time() == pytest.approx(0.3)
        assert took == [(1, 5, LoopClock(1.0).now_ns())]

    virtual(main())


def test_the_traffic_that_is_shown_is_that_of_the_last_two_seconds(rig: Any) -> None:
    async def main() -> None:
        session: Any = Bench(rig).session
        assert session._bytes_per_s(500) == 0.0
        await asyncio.sleep(1.0)
        assert session._bytes_per_s(700) == pytest.approx(200.0)
        await asyncio.sleep(1.5)
        assert session._bytes_per_s(700) == 0.0

    virtual(main())


def test_the_other_drone_may_be_silent_for_less_long_while_it_is_near(rig: Any) -> None:
    async def main() -> None:
        session = Bench(rig).session
        guard = MissionConfig().guard
        for phase, most_s in (
            (Phase.FOLLOW, guard.peer_silence_s),
            (Phase.VERIFY, guard.near_silence_s),
        ):
            session.phase = phase
            session.peer_heard_ns = session.now_ns() - round(most_s * S)
            session.require_peer()
            session.peer_heard_ns -= 1_000_000
            with pytest.raises(MissionEnd):
                session.require_peer()

    virtual(main())


def test_how_a_flight_ended_is_said_five_times_and_only_when_it_has(rig: Any) -> None:
    async def main() -> None:
        bench = Bench(rig)
        await bench.session.say_goodbye()
        assert bench.link.sent == []
        bench.session.end = MissionEnd(Outcome.GUARD, "x")
        await bench.session.say_goodbye()
        times = [round(time_s, 3) for time_s, _ in bench.link.sent]
        assert times == [0.0, 0.05, 0.1, 0.15, 0.2]

    virtual(main())


def test_frames_that_need_not_be_looked_at_pass_at_four_fifths_of_their_period(rig: Any) -> None:
    async def main() -> None:
        session = Bench(rig).session
        await session.skip_frames()
        assert asyncio.get_running_loop().time() == pytest.approx(0.8 / session.config.follow_hz)
        session.note_height(0.4)
        assert session.off_n_m == (0.0, 0.0, 0.4)
        assert session.here(PEER).position_n_m == pytest.approx((4.0, 3.0, -1.1))
        session.note_height(0.1)  # the picture of the other drone moves with it
        assert session.here(PEER).position_n_m == pytest.approx((4.0, 3.0, -1.4))

    virtual(main())
