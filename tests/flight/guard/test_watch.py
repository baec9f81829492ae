"""The guard's loop in virtual time, with a vehicle and a line that are written down."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from dataclasses import dataclass, field, replace
from typing import Any, Self

import pytest

from drivers.interfaces import FlightMode
from drivers.mavlink.guard.interfaces import Beat, GuardAnswer, GuardView, Hand, Script
from flight.config import MissionConfig
from flight.guard.rules import SURE, Act, GuardStage, GuardState, ProgramBeat
from flight.guard.watch import STALL_S, GuardWatch, watch
from hil.harness.virtual_time import run_virtual
from tests.doubles import LoopClock

CONFIG = MissionConfig()
RULES = CONFIG.guard_process
S = 1_000_000_000
GROUND = GuardView(0, 0, False, False, FlightMode.HOLD, (0.0, 0.0, 0.0), 0.9, None)


@dataclass
class FakeVehicle:
    """Does what it is told, a tick later, unless it is ``stubborn``."""

    now: GuardView = GROUND
    told: list[tuple[float, str]] = field(default_factory=list[tuple[float, str]])
    stubborn: bool = False
    silent: bool = False
    lost: bool = False  # beats, and does not know where it is
    name: str = "a vehicle"
    ignored: dict[str, int] = field(default_factory=dict[str, int])

    def view(self) -> GuardView | None:
        if not self.silent:
            now_ns = LoopClock(1000.0).now_ns()
            position_ns = self.now.position_ns if self.lost else now_ns
            self.now = replace(self.now, heartbeat_ns=now_ns, position_ns=position_ns)
        return self.now

    def fly(self, mode: FlightMode = FlightMode.OFFBOARD) -> None:
        self.now = replace(self.now, armed=True, in_air=True, mode=mode)

    def hold(self) -> None:
        self._obey("hold", FlightMode.HOLD)

    def land(self) -> None:
        self._obey("land", FlightMode.LAND)

    def _obey(self, what: str, mode: FlightMode) -> None:
        self.told.append((asyncio.get_running_loop().time(), what))
        if not self.stubborn:
            asyncio.get_running_loop().call_later(0.005, self.fly, mode)

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None: ...


@dataclass
class FakeLine:
    waiting: Beat | None = None
    answers: list[GuardAnswer] = field(default_factory=list[GuardAnswer])
    ignored: dict[str, int] = field(default_factory=dict[str, int])

    def newest(self) -> tuple[int, Beat] | None:
        beat, self.waiting = self.waiting, None
        return None if beat is None else (LoopClock(1000.0).now_ns(), beat)

    def answer(self, answer: GuardAnswer) -> None:
        self.answers.append(answer)

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None: ...


@dataclass
class ListLog:
    records: list[tuple[str, dict[str, Any]]] = field(
        default_factory=list[tuple[str, dict[str, Any]]]
    )

    def write(self, topic: str, stamp_ns: int, record: Any) -> None:
        self.records.append((topic, dict(record)))

    def image(self, topic: str, stamp_ns: int, image: Any) -> None: ...


class Bench:
    """A guard, and a role that beats until it is ``hung``."""

    def __init__(self, config: MissionConfig = CONFIG) -> None:
        self.vehicle, self.line, self.log = FakeVehicle(), FakeLine(), ListLog()
        self.guard = GuardWatch(self.vehicle, self.line, LoopClock(1000.0), config, self.log)
        self.script, self.hung, self.setpoints = Script.IDLE, False, 0
        self.stop = asyncio.Event()
        self._tasks = [
            asyncio.create_task(watch((self.guard,), self.stop)),
            asyncio.create_task(self._role()),
        ]

    async def _role(self) -> None:
        while True:
            if not self.hung:
                self.line.waiting = Beat(self.script, self.setpoints)
                self.setpoints += self.script is Script.CONTROL
            await asyncio.sleep(0.05)

    async def in_control(self) -> None:
        self.vehicle.fly()
        self.script = Script.CONTROL
        await asyncio.sleep(1.0)
        assert self.vehicle.told == []
        assert self.line.answers[-1] == GuardAnswer(True, Hand.SCRIPT)

    async def end(self) -> None:
        self.stop.set()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    @property
    def stages(self) -> list[str]:
        return [record["stage"] for topic, record in self.log.records if topic == "/guard"]


def virtual(main: Coroutine[Any, Any, None]) -> None:
    run_virtual(main)


def test_a_program_that_hangs_is_found_in_time_and_its_vehicle_brought_down() -> None:
    async def main() -> None:
        bench, loop = Bench(), asyncio.get_running_loop()
        await bench.in_control()
        hung_s, bench.hung = loop.time(), True
        await asyncio.sleep(5.0)
        (hold_s, held), (land_s, landed) = bench.vehicle.told
        assert (held, landed) == ("hold", "land")
        assert hold_s - hung_s <= RULES.beat_age_s + 0.1
        assert land_s - hold_s == pytest.approx(RULES.hold_s, abs=0.1)
        assert bench.stages == ["holding", "landing"]
        (held_after_s, _) = [
            record["beat_age_s"] for topic, record in bench.log.records if topic == "/guard"
        ]
        assert held_after_s == pytest.approx(RULES.beat_age_s, abs=0.1)
        assert bench.line.answers[-1].hand is Hand.GUARD  # it waits for a role that wakes up
        bench.hung = False
        await asyncio.sleep(0.1)
        assert bench.line.answers[-1].hand is Hand.GUARD
        bench.vehicle.now = replace(bench.vehicle.now, armed=False, in_air=False)
        await asyncio.sleep(0.1)
        assert bench.line.answers[-1] == GuardAnswer(True, Hand.FREE)
        await bench.end()

    virtual(main())


def test_the_vehicle_is_in_the_log_twice_a_second() -> None:
    async def main() -> None:
        bench = Bench()
        await bench.in_control()
        await asyncio.sleep(4.0)
        views = [record for topic, record in bench.log.records if topic == "/guard_view"]
        assert len(views) == pytest.approx(10, abs=1)
        await bench.end()

    virtual(main())


def test_setpoints_that_stop_while_beats_go_on() -> None:
    async def main() -> None:
        bench = Bench()
        await bench.in_control()
        bench.line.newest()
        bench.hung = True
        for _ in range(20):
            bench.line.waiting = Beat(Script.CONTROL, bench.setpoints)
            await asyncio.sleep(0.05)
        assert [what for _, what in bench.vehicle.told] == ["hold"]
        assert "no setpoint" in bench.guard.state.reason
        await bench.end()

    virtual(main())


def test_the_guards_own_stall_is_no_fault_of_the_role() -> None:
    async def main() -> None:
        bench, clock = Bench(), LoopClock(1000.0)
        await bench.in_control()
        await bench.end()
        guard = bench.guard
        guard.tick()
        await asyncio.sleep(5.0)  # nobody had a core
        guard.tick()
        assert bench.vehicle.told == []
        assert "/guard_stalled" in [topic for topic, _ in bench.log.records]
        for _ in range(30):  # and then the role is still silent
            guard.tick()
            await asyncio.sleep(0.02)
        assert [what for _, what in bench.vehicle.told] == ["hold"]
        assert clock.now_ns() > 0

    virtual(main())


def test_a_stall_of_the_guards_own_makes_no_beat_younger_than_now() -> None:
    """A beat that had just come before: a program that dies then is found as soon as any other."""

    async def main() -> None:
        bench = Bench()
        await bench.in_control()
        await bench.end()
        guard = bench.guard
        guard.tick()
        assert guard._heard is not None
        just_after_ns = LoopClock(1000.0).now_ns() + 1_000_000
        guard._heard = replace(guard._heard, beat_ns=just_after_ns, setpoint_ns=just_after_ns)
        await asyncio.sleep(5.0)
        guard._forgive_own_stall(LoopClock(1000.0).now_ns())
        assert guard._heard.beat_ns == guard._heard.setpoint_ns == LoopClock(1000.0).now_ns()

    virtual(main())


@pytest.mark.parametrize(("ticks_apart_s", "forgives"), [(STALL_S - 1e-6, False), (STALL_S, True)])
def test_a_guard_that_ticks_in_time_forgives_nothing(ticks_apart_s: float, forgives: bool) -> None:
    async def main() -> None:
        bench = Bench()
        await bench.in_control()
        await bench.end()
        now_ns = LoopClock(1000.0).now_ns()
        bench.guard._forgive_own_stall(now_ns)
        bench.log.records.clear()
        bench.guard._forgive_own_stall(now_ns + round(ticks_apart_s * 1e9))
        assert bool(bench.log.records) is forgives

    virtual(main())


@pytest.mark.parametrize(("more_ns", "hears"), [(0, True), (1000, False)])
def test_a_program_is_heard_for_as_long_as_the_rules_say(more_ns: int, hears: bool) -> None:
    async def main() -> None:
        bench = Bench()
        await bench.in_control()
        await bench.end()
        assert bench.guard._heard is not None
        beat_ns = LoopClock(1000.0).now_ns() - round(RULES.beat_age_s * 1e9) - more_ns
        bench.guard._heard = replace(bench.guard._heard, beat_ns=beat_ns)
        assert bench.guard.hears is hears

    virtual(main())


@pytest.mark.parametrize(("more_ns", "sees"), [(0, True), (1000, False)])
def test_a_vehicle_is_seen_for_as_long_as_the_rules_say(more_ns: int, sees: bool) -> None:
    async def main() -> None:
        bench = Bench()
        await bench.end()
        old = replace(GROUND, heartbeat_ns=S, position_ns=S + 1)
        assert bench.guard._sees(old, S + round(RULES.blind_s * 1e9) + more_ns) is sees

    virtual(main())


def test_a_position_that_was_never_told_is_not_seen_however_young_the_clock() -> None:
    """A clock that begins at 0 does not make the stamp of nothing a fresh one."""

    async def main() -> None:
        bench = Bench()
        await bench.end()
        told = replace(GROUND, heartbeat_ns=1, position_ns=1)
        assert bench.guard._sees(told, 1000)
        assert not bench.guard._sees(replace(told, position_ns=0), 1000)

    virtual(main())


def test_whoever_started_the_guard_is_told_of_every_decision() -> None:
    told: list[tuple[GuardStage, Act]] = []

    def tell(state: GuardState, act: Act) -> None:
        told.append((state.stage, act))

    async def main() -> None:
        bench = Bench()
        bench.guard._tell = tell
        await bench.in_control()
        bench.hung = True
        await asyncio.sleep(RULES.beat_age_s + RULES.hold_s + 1.0)
        bench.vehicle.now = replace(bench.vehicle.now, armed=False, in_air=False)
        await asyncio.sleep(1.0)
        await bench.end()

    virtual(main())
    assert told == [
        (GuardStage.HOLDING, Act.HOLD),
        (GuardStage.LANDING, Act.LAND),
        (GuardStage.WATCHING, Act.NOTHING),
    ]


def test_a_program_that_died_has_no_part_in_the_next_flight() -> None:
    """A pilot may hold the vehicle that a script flew before, without being landed for it."""

    async def main() -> None:
        bench = Bench()
        await bench.in_control()
        bench.vehicle.now = replace(bench.vehicle.now, armed=False, in_air=False)
        bench.hung = True
        await asyncio.sleep(1.0)
        bench.vehicle.fly(FlightMode.HOLD)
        await asyncio.sleep(10.0)
        assert bench.vehicle.told == []
        await bench.end()

    virtual(main())


def test_what_is_blind_says_so_and_sends_nothing() -> None:
    async def main() -> None:
        bench = Bench()
        await bench.in_control()
        bench.vehicle.silent = True
        await asyncio.sleep(RULES.blind_s + 0.2)
        assert bench.line.answers[-1].sees is False
        bench.hung = True
        await asyncio.sleep(5.0)
        assert bench.vehicle.told == []
        await bench.end()

    virtual(main())


def test_heartbeats_alone_are_not_seeing_where_the_vehicle_is() -> None:
    """The fence and the distances are kept by positions: a guard whose positions stopped says that
    it is blind.
    """

    async def fly() -> Bench:
        bench = Bench()
        await bench.in_control()
        bench.vehicle.lost = True
        await asyncio.sleep(RULES.blind_s - 0.2)
        assert bench.line.answers[-1].sees
        assert bench.guard.needed and bench.guard.flown
        await asyncio.sleep(0.4)
        assert not bench.line.answers[-1].sees
        assert not (bench.guard.needed or bench.guard.flown)
        bench.vehicle.lost = False
        await asyncio.sleep(0.1)
        assert bench.line.answers[-1].sees and bench.guard.needed
        await bench.end()
        return bench

    assert run_virtual(fly()).vehicle.told == []


@pytest.mark.parametrize("goes_on", [True, False])
def test_a_distance_that_is_not_measured_any_more_is_forgotten(goes_on: bool) -> None:
    """Measured once, near, while a beat was late: what is measured again counts, and what is old
    does not.
    """

    async def fly() -> Bench:
        bench = Bench()
        await bench.in_control()
        guard = bench.guard
        now_ns = LoopClock(1000.0).now_ns()
        bench.line.waiting = Beat(Script.CONTROL, bench.setpoints, separation_m=5.0)
        guard.tick()
        bench.line.waiting = Beat(Script.CONTROL, bench.setpoints)
        await asyncio.sleep(0.2)
        assert guard._heard is not None
        assert (guard._heard.separation_m, guard._heard.separation_ns) == (5.0, now_ns)
        if goes_on:
            bench.line.waiting = Beat(Script.CONTROL, bench.setpoints, separation_m=4.0)
            guard.tick()
            assert guard._heard.separation_m == 4.0 and guard._heard.separation_ns > now_ns
        await bench.end()
        return bench

    assert run_virtual(fly()).vehicle.told == []


def test_a_near_distance_of_long_ago_does_not_take_the_vehicle() -> None:
    """It was within the bounds of its own time only: the rules are asked with a fresh one and with
    an old one.
    """

    async def fly(age_s: float) -> list[tuple[float, str]]:
        bench = Bench()
        await bench.in_control()
        guard = bench.guard
        assert guard._heard is not None
        old_ns = LoopClock(1000.0).now_ns() - round(age_s * 1e9)
        guard._heard = replace(guard._heard, separation_m=0.1, separation_ns=old_ns)
        await asyncio.sleep(RULES.patience_s + 0.1)
        told = list(bench.vehicle.told)
        await bench.end()
        return told

    assert run_virtual(fly(RULES.beat_age_s + 0.1)) == []


def test_two_vehicles_of_one_program_know_each_others_places() -> None:
    async def main() -> None:
        exact = replace(CONFIG, guard_process=replace(RULES, position_error_m=0.1))
        bench, other = Bench(exact), FakeVehicle()
        bench.guard.peer = other
        other.now = replace(GROUND, in_air=True, position_n_m=(0.3, 0.0, 0.0))
        bench.vehicle.fly()
        bench.script = Script.CONTROL
        await asyncio.sleep(RULES.patience_s + 0.2)
        assert [what for _, what in bench.vehicle.told] == ["hold"]
        assert "by the drones' positions" in bench.guard.state.reason
        await bench.end()

    virtual(main())


def test_it_ends_only_when_nothing_is_left_to_guard() -> None:
    async def main() -> None:
        bench = Bench()
        await bench.in_control()
        bench.stop.set()
        await asyncio.sleep(1.0)
        assert bench.guard.needed
        bench.hung = bench.vehicle.stubborn = True
        await asyncio.sleep(RULES.land_tries * RULES.ack_s + 5.0)
        assert bench.guard.state.stage is GuardStage.GAVE_UP
        assert not bench.guard.needed
        assert bench._tasks[0].done()
        await bench.end()

    virtual(main())


def test_what_a_person_flies_needs_no_guard_whether_a_script_is_there_or_not() -> None:
    async def main() -> None:
        bench = Bench()
        bench.hung = True
        bench.vehicle.fly(FlightMode.HOLD)
        await asyncio.sleep(1.0)
        assert not bench.guard.needed
        bench.hung = False
        await asyncio.sleep(0.2)
        assert not bench.guard.needed
        await bench.end()

    virtual(main())


def test_what_was_let_go_of_and_flies_by_script_needs_its_guard() -> None:
    async def main() -> None:
        bench = Bench()
        await bench.end()
        bench.vehicle.fly()
        bench.vehicle.now = replace(bench.vehicle.now, mode_told=SURE)
        bench.guard._heard = ProgramBeat(LoopClock(1000.0).now_ns(), Script.LET_GO, 0)
        assert bench.guard.needed
        bench.vehicle.fly(FlightMode.OTHER)
        assert not bench.guard.needed

    virtual(main())


def test_a_script_that_beats_on_the_ground_is_not_forgotten() -> None:
    async def main() -> None:
        bench = Bench()
        bench.script = Script.CLIMB
        await asyncio.sleep(2.0)
        views = [record for topic, record in bench.log.records if topic == "/guard_view"]
        assert views[-1]["script"] == "climb"
        await bench.end()

    virtual(main())


def test_what_is_ignored_raises_an_alarm_once_and_the_role_is_told() -> None:
    async def main() -> None:
        bench = Bench()
        await bench.in_control()
        for _ in range(3):
            bench.line.ignored["beats of another"] = (
                bench.line.ignored.get("beats of another", 0) + 1
            )
            await asyncio.sleep(0.6)
        assert bench.line.answers[-1] == GuardAnswer(True, Hand.SCRIPT, "", "beats of another")
        alarms = [record for topic, record in bench.log.records if topic == "/guard_alarm"]
        assert alarms == [{"ignored": "beats of another"}]
        views = [record["ignored"] for topic, record in bench.log.records if topic == "/guard_view"]
        assert views[0] == {} and views[-1] == {"beats of another": 3}
        await bench.end()

    run_virtual(main())
