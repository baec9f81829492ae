"""What a session tells of an estimator that steps, and whom: crew, log, gate, guard; and what the
other drone hears.
"""

from __future__ import annotations

import asyncio
import math
from dataclasses import dataclass, replace
from typing import Any, cast

import pytest

from drivers.interfaces import VehicleState
from drivers.log.topics import TOPICS
from flight.guidance import Vec3, add
from flight.outcome import Outcome
from missions.fly.leg.beside import watch_estimator
from missions.fly.leg.session import RoleSession
from path.geometry.rotation import quat_from_rpy
from path.messages import Role, Status
from tests.doubles import LoopClock
from tests.missions.fly.leg.session_bench import STATE, Bench, virtual

STEP_AT_S = 5.0
SHIFT: Vec3 = (1.0, -0.5, -0.3)
TURN_RAD = 0.35
PEER = Status(Role.RECEIVER, 1, (4.0, 4.0, -2.0), (0.0, 0.0, 0.0), 0.0, 8, False, False, 0.9)


@dataclass
class Stepping:
    """A vehicle that hangs where it is, fifty states a second, and whose estimator steps."""

    asked_ns: int = 0

    @property
    def state(self) -> VehicleState:
        now_s = asyncio.get_running_loop().time()
        stamp_ns = LoopClock(1.0).now_ns() // 20_000_000 * 20_000_000
        if now_s < STEP_AT_S:
            return replace(STATE, stamp_ns=stamp_ns, velocity_n_mps=(0.0, 0.0, 0.0))
        return replace(
            STATE,
            stamp_ns=stamp_ns,
            velocity_n_mps=(0.0, 0.0, 0.0),
            position_n_m=add(STATE.position_n_m, SHIFT),
            q_n_b=quat_from_rpy(0.0, 0.0, TURN_RAD),
        )


class Stepped(Bench):
    """A session on it, with what its role was told."""

    def __init__(self, rig: Any) -> None:
        super().__init__(rig)
        session = self.session
        parts = cast(Any, (LoopClock(1.0), Stepping(), None, self.link))
        self.session = RoleSession(
            rig,
            Role.SENDER,
            session.config,
            self.log,
            self.shown.append,
            self.stop,
            parts,
            session.entropy,
        )
        self.told: list[int] = []  # stamps
        self.session.on_step = self.told.append


async def look(bench: Stepped) -> None:
    """The course of a role whose background tasks look at the vehicle, until some time after the
    step.
    """
    await asyncio.sleep(STEP_AT_S + 2.0)


def test_a_step_is_told_to_crew_log_and_role_once(rig: Any) -> None:
    async def main() -> None:
        bench = Stepped(rig)
        result = await bench.fly(lambda: look(bench))
        assert result.outcome is Outcome.COMMITTED
        (record,) = bench.log.of("/estimator_step")
        assert record["shift_n_m"] == pytest.approx(SHIFT)
        assert record["turn_rad"] == pytest.approx(TURN_RAD)
        assert set(record) == set(TOPICS["/estimator_step"].fields)
        assert [note["note"] for note in bench.log.of("/note")] == [
            "ALARM: the estimator stepped: its place by 1.12 m and its height by +0.30 m and its heading by "
            "+20 degrees; the flight goes on as if it had not"
        ]
        assert bench.told == [
            stamp for topic, stamp, _ in bench.log.entries if topic == "/estimator_step"
        ]

    virtual(main())


def test_the_other_drone_hears_that_it_stepped_and_from_where_it_was_before(rig: Any) -> None:
    async def main() -> None:
        bench = Stepped(rig)
        await bench.fly(lambda: look(bench))
        statuses = bench.link.of(Status)
        assert [statuses[0].steps, statuses[-1].steps] == [0, 1]
        assert max(math.dist(each.position_n_m, STATE.position_n_m) for each in statuses) < 0.01
        assert max(abs(each.yaw_rad) for each in statuses) < 0.01
        assert statuses[-1].stamp_ns > (STEP_AT_S + 2.0) * 1e9

    virtual(main())


def test_the_guard_is_told_of_the_other_drone_where_the_autopilot_would_have_it(rig: Any) -> None:
    async def main() -> None:
        bench = Stepped(rig)

        async def heard() -> None:
            await look(bench)
            bench.session.peer, bench.session.peer_heard_ns = PEER, bench.session.now_ns()
            assert bench.session.here(PEER).position_n_m == PEER.position_n_m
            assert bench.session.guarding.beat().peer_n_m == pytest.approx(
                add(PEER.position_n_m, SHIFT)
            )

        assert (await bench.fly(heard)).detail == ""

    virtual(main())


def test_evidence_begins_anew_when_the_other_drone_says_that_it_stepped(rig: Any) -> None:
    async def main() -> None:
        bench = Stepped(rig)

        async def course() -> None:
            # 63, 1: its count goes round; 1, 0: it was started again
            for steps in (2, 2, 3, 3, 63, 1, 0, 1):
                bench.link.waiting.put_nowait(replace(PEER, steps=steps))
                await asyncio.sleep(0.1)
            bench.link.waiting.put_nowait(replace(PEER, steps=9, instance=5))  # another one
            await asyncio.sleep(0.1)

        await bench.fly(course)
        assert [record["steps"] for record in bench.log.of("/peer_step")] == [3, 1, 1]
        assert len(bench.told) == 3
        assert bench.log.of("/note")[0]["note"] == "ALARM: the other drone's estimator stepped"

    virtual(main())


def test_a_session_that_begins_later_does_not_tell_of_earlier_steps(rig: Any) -> None:
    async def main() -> None:
        bench = Stepped(rig)
        looking = asyncio.create_task(watch_estimator(bench.session))
        await look(bench)
        looking.cancel()
        session, told = bench.session, len(bench.log.of("/estimator_step"))
        parts = cast(Any, (LoopClock(1.0), session.vehicle, None, bench.link))
        later = RoleSession(
            session.rig,
            Role.SENDER,
            session.config,
            bench.log,
            bench.shown.append,
            bench.stop,
            parts,
            session.entropy,
        )
        later.note_steps()
        assert len(bench.log.of("/estimator_step")) == told == 1
        assert later.vehicle is session.vehicle

    virtual(main())
