"""The order of both courses, step by step, on hand-overs and ways that stand in."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from types import SimpleNamespace
from typing import Any, cast

import pytest

from drivers.log.state_file import MemoryStore
from flight.config import MissionConfig
from flight.outcome import MissionEnd, Outcome
from flight.phases import Phase
from missions.fly.leg.receiver import Receiver
from missions.fly.leg.sender import Sender
from path.messages import Role
from tests.missions.fly.leg.session_bench import STATE, Bench, virtual

CONFIG = MissionConfig()
WHY = MissionEnd(Outcome.APPROACH_FAILED, "closing in at 1.1 m/s")


class Steps:
    """What was done, in order."""

    def __init__(self) -> None:
        self.done: list[str] = []

    def step(self, name: str, takes_s: float = 0.0) -> Callable[..., Coroutine[Any, Any, None]]:
        async def do(*_: object) -> None:
            self.done.append(name)
            await asyncio.sleep(takes_s)

        return do


class Course:
    """A receiver whose approach fails some times, and then arrives."""

    def __init__(self, rig: Any, monkeypatch: pytest.MonkeyPatch, failures: int) -> None:
        self.bench = Bench(rig, role=Role.RECEIVER)
        self.session = self.bench.session
        self.receiver: Any = Receiver(self.session, MemoryStore())
        self.steps, self.failures = Steps(), failures
        self.seen: list[object] = []
        step = self.steps.step
        monkeypatch.setattr("missions.fly.leg.receiver.preflight", step("preflight"))
        self.receiver._handover = SimpleNamespace(
            resume=step("resume"),
            start=lambda: self.steps.done.append("start"),
            until_held=self._until_held,
        )
        for name in ("_watch_peer", "_watch", "_rise"):
            setattr(self.receiver, name, step(name))
        self.receiver._until_planned = step("plan")
        self.receiver._find_marker = self._find_marker
        self.receiver._approach = self._approach
        self.receiver._newest = object()
        self.receiver._in_view = lambda: True
        self.near: list[bool] = []

    async def _until_held(self, timeout_s: float) -> None:
        self.steps.done.append("held")
        self.seen += [self.session.phase, self.session.observing, timeout_s]

    async def _find_marker(self, near_enough: Callable[[], bool]) -> None:
        self.steps.done.append("marker")
        self.near.append(near_enough == self.receiver._near)
        await asyncio.sleep(0.1)

    async def _approach(self) -> MissionEnd | None:
        self.steps.done.append("approach")
        self.failures -= 1
        return WHY if self.failures >= 0 else None


def test_a_receiver_goes_around_as_often_as_the_mission_says_and_then_takes_over(
    rig: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def main() -> None:
        course = Course(rig, monkeypatch, CONFIG.rendezvous.go_arounds)
        await course.receiver.course()
        around = ["marker", "approach"] * CONFIG.rendezvous.go_arounds
        own = [step for step in course.steps.done if not step.startswith("_watch")]
        assert own == [
            "resume",
            "preflight",
            "start",
            "plan",
            "_rise",
            "marker",
            "approach",
            *around,
            "held",
        ]
        beside = [step for step in course.steps.done if step.startswith("_watch")]
        assert beside == ["_watch_peer", "_watch"]
        assert course.near == [True] + [False] * CONFIG.rendezvous.go_arounds
        assert course.seen == [Phase.VERIFY, True, 2.0 * CONFIG.deadlines.verify_s]
        phases = [record["phase"] for record in course.bench.log.of("/phase")]
        assert phases == ["waiting", "verify", "follow"]
        notes = [record["note"] for record in course.bench.log.of("/note")]
        assert notes == ["goes around: closing in at 1.1 m/s"] * CONFIG.rendezvous.go_arounds
        assert (
            0
            < course.receiver._taken_ns
            <= course.session.now_ns() - round(CONFIG.follow_after_s * 1e9)
        )
        await course.session.cancel_spawned()

    virtual(main())


def test_a_receiver_that_may_not_go_around_any_more_ends_by_what_was_wrong(
    rig: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def main() -> None:
        course = Course(rig, monkeypatch, CONFIG.rendezvous.go_arounds + 1)
        with pytest.raises(MissionEnd) as caught:
            await course.receiver.course()
        assert caught.value is WHY and "held" not in course.steps.done
        await course.session.cancel_spawned()

    virtual(main())


def test_a_target_that_is_out_of_view_at_the_end_is_lost(
    rig: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def main() -> None:
        course = Course(rig, monkeypatch, 0)
        course.receiver._in_view = lambda: False
        with pytest.raises(MissionEnd) as caught:
            await course.receiver.course()
        assert caught.value.outcome is Outcome.LOST_AFTER and "not seen" in caught.value.detail
        await course.session.cancel_spawned()

    virtual(main())


class Way:
    """A rendezvous of which each answer can be set."""

    def __init__(self) -> None:
        self.stood_off = self.arrived = False
        self.out = ""
        self.searches = 0

    def to_stand_off(self, _state: object) -> None: ...

    def search(self, _state: object) -> None: ...

    def to_viewpoint(self, _state: object) -> None: ...

    def at_stand_off(self, state: object) -> bool:
        assert state == STATE
        return self.stood_off

    def at_viewpoint(self) -> bool:
        return self.arrived

    def out_of_bounds(self) -> str:
        return self.out

    def begin_search(self) -> None:
        self.searches += 1


class Approaching:
    """A receiver on such a way."""

    def __init__(self, rig: Any) -> None:
        self.bench = Bench(rig, role=Role.RECEIVER)
        self.session = self.bench.session
        self.receiver: Any = Receiver(self.session, MemoryStore())
        self.way, self.found, self.unseen_s = Way(), False, 0.0
        self.receiver._rendezvous = self.way

        def found(_now_ns: int) -> bool:
            return self.found

        def unseen_s(_now_ns: int) -> float:
            return self.unseen_s

        self.receiver._marker = SimpleNamespace(found=found, unseen_s=unseen_s)
        self.receiver._until_planned = Steps().step("plan")


@pytest.mark.parametrize("by", ["place", "marker"])
def test_the_search_begins_at_the_stand_off_or_near_enough_and_within_the_bounds(
    rig: Any, by: str
) -> None:
    async def main() -> None:
        there = Approaching(rig)
        near = [False]
        finding = asyncio.create_task(there.receiver._find_marker(lambda: near[0]))
        await asyncio.sleep(1.0)
        assert (
            there.session.phase is Phase.STAND_OFF
            and there.session.pilot.guidance == there.way.to_stand_off
        )
        there.way.out = "too near"
        there.way.stood_off, near[0] = by == "place", by == "marker"
        await asyncio.sleep(1.0)
        assert there.session.phase is Phase.STAND_OFF and there.way.searches == 0
        there.way.out = ""
        await asyncio.sleep(0.2)
        assert there.session.phase is Phase.SEARCH and there.way.searches == 1
        assert there.session.pilot.guidance == there.way.search
        there.found = False
        await asyncio.sleep(0.2)
        assert not finding.done()
        there.found = True
        await asyncio.sleep(0.2)
        assert finding.done() and finding.exception() is None

    virtual(main())


@pytest.mark.parametrize("stood_off", [False, True])
def test_a_stand_off_that_is_not_reached_and_a_marker_that_is_not_found_have_their_ends(
    rig: Any, stood_off: bool
) -> None:
    async def main() -> None:
        there = Approaching(rig)
        there.way.stood_off = stood_off
        with pytest.raises(MissionEnd) as caught:
            await there.receiver._find_marker(lambda: False)
        assert caught.value.outcome is (
            Outcome.MARKER_NOT_FOUND if stood_off else Outcome.APPROACH_FAILED
        )

    virtual(main())


def test_a_receiver_has_arrived_once_it_was_at_its_viewpoint_for_0_6_seconds(rig: Any) -> None:
    async def main() -> None:
        there, loop = Approaching(rig), asyncio.get_running_loop()
        approaching = asyncio.create_task(there.receiver._approach())
        await asyncio.sleep(2.0)
        assert (
            there.session.phase is Phase.APPROACH
            and there.session.pilot.guidance == there.way.to_viewpoint
        )
        there.way.arrived = True
        await asyncio.sleep(0.4)
        there.way.arrived = False  # it swings through
        await asyncio.sleep(0.4)
        assert not approaching.done()
        there.way.arrived, began_s = True, loop.time()
        assert await approaching is None
        assert loop.time() - began_s == pytest.approx(0.65, abs=0.1)

    virtual(main())


@pytest.mark.parametrize(
    ("unseen_s", "out", "outcome", "said"),
    [
        (5.1, "", Outcome.MARKER_LOST, "marker not seen for 5.1 s"),
        (5.0, "0.80 m from the marker", Outcome.APPROACH_FAILED, "0.80 m from the marker"),
        (
            5.0,
            "",
            Outcome.APPROACH_FAILED,
            f"no viewpoint reached in {CONFIG.deadlines.approach_s:.0f} s",
        ),
    ],
)
def test_an_approach_that_fails_says_why(
    rig: Any, unseen_s: float, out: str, outcome: Outcome, said: str
) -> None:
    async def main() -> None:
        there = Approaching(rig)
        there.unseen_s, there.way.out = unseen_s, out
        end = await there.receiver._approach()
        assert end is not None and (end.outcome, end.detail) == (outcome, said)
        late_s = 0.0 if out or unseen_s > 5.0 else CONFIG.deadlines.approach_s
        assert asyncio.get_running_loop().time() == pytest.approx(late_s, abs=0.2)

    virtual(main())


def test_a_sender_follows_offers_verifies_and_leaves_while_it_watches(rig: Any) -> None:
    async def main() -> None:
        bench = Bench(rig)
        session = bench.session
        sender: Any = Sender(session, MemoryStore())
        steps = Steps()
        seen: list[object] = []

        async def decided(timeout_s: float, anew: object) -> None:
            steps.done.append("decided")
            seen.extend(
                [session.phase, session.observing, timeout_s, anew == sender._begin_attempt]
            )

        async def settled() -> None:
            steps.done.append("settled")
            seen.append(session.pilot.guidance == sender._leave_watching)

        sender._handover = SimpleNamespace(
            offer=steps.step("offer"), epoch=3, until_decided=decided, until_settled=settled
        )
        sender._watch_peer = steps.step("watch")
        handing = asyncio.create_task(sender.hand_over())
        await asyncio.sleep(1.0)
        assert session.phase is Phase.FOLLOW and session.pilot.guidance == sender._follow_target
        assert session.observing and steps.done == ["offer", "watch"] and not handing.done()
        (attempt,) = bench.log.of("/attempt")
        assert attempt["epoch"] == 3 and sender._side is not None
        sender._candidates = 1
        await asyncio.sleep(0.2)
        assert handing.done() and handing.exception() is None
        assert steps.done == ["offer", "watch", "decided", "settled"]
        assert seen == [Phase.VERIFY, True, CONFIG.deadlines.verify_s, True, True]
        assert not session.observing
        assert bench.log.of("/note") == [{"note": "handed over"}]
        await session.cancel_spawned()

    virtual(main())


def test_a_receiver_that_never_answers_is_no_agreement(rig: Any) -> None:
    async def main() -> None:
        sender: Any = Sender(Bench(rig).session, MemoryStore())
        sender._handover = SimpleNamespace(offer=Steps().step("offer"), epoch=1)
        sender._watch_peer = Steps().step("watch")
        with pytest.raises(MissionEnd) as caught:
            await sender.hand_over()
        assert caught.value.outcome is Outcome.NO_AGREEMENT
        late_s = CONFIG.deadlines.receiver_ready_s
        assert asyncio.get_running_loop().time() == pytest.approx(late_s, abs=0.2)

    virtual(main())


def test_a_sender_looks_for_its_target_until_it_has_one_and_asks_nothing_any_more(rig: Any) -> None:
    async def main() -> None:
        session = Bench(rig).session
        sender: Any = Sender(session, MemoryStore())
        done: list[str] = []

        async def listen() -> None:
            done.append("listen")
            try:
                await asyncio.sleep(1e6)
            finally:
                done.append("silent")

        sender._designating = SimpleNamespace(
            listen=listen, stop=lambda: done.append("stop"), why=lambda: "nothing"
        )
        sender._watch = Steps().step("watch")
        acquiring = asyncio.create_task(sender.acquire())
        await asyncio.sleep(1.0)
        assert session.phase is Phase.ACQUIRE and session.pilot.guidance == sender._to_first_place
        sender._track = cast(Any, object())
        await acquiring
        await asyncio.sleep(0.1)
        assert done == ["listen", "stop", "silent"]
        await session.cancel_spawned()

    virtual(main())
