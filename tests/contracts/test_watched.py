"""The contract of every vehicle that a guard watches: on a MAVLink of its own, and in the simulated
world.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import pytest

from drivers.interfaces import FlightMode
from drivers.mavlink.guard.interfaces import GuardView, Watched
from drivers.mavlink.guard_link import GuardMavlink, GuardMavlinkConfig
from hil.autopilot.autopilot import Ack
from hil.harness.guard import SimGuard
from hil.harness.virtual_time import run_virtual
from hil.world.config import WorldConfig
from hil.world.world import World
from path.messages import Role
from tests.drivers.mavlink.test_guard_link import BIND, CONTEXT
from tests.guard_bench import bench
from tests.hil.vehicle.test_sim_vehicle import Harness, context

PATIENCE_S = 60.0


@dataclass
class Stage:
    """``lift`` has it hover; ``told``: the modes that the vehicle was told to enter, by anybody."""

    watched: Watched
    now_ns: Callable[[], int]
    lift: Callable[[], object]
    silence: Callable[[], object]
    told: Callable[[], int]
    run: Callable[[Any], Any]


@dataclass
class GuardedHarness(Harness):
    lost_vehicles: set[Role] = field(default_factory=set[Role])


@contextmanager
def sim() -> Generator[Stage]:
    harness = GuardedHarness(World(WorldConfig(), 1))
    here = context(harness)
    autopilot = harness.truth.drone(Role.SENDER).autopilot
    told: list[FlightMode] = []
    request = autopilot.request_mode

    def counted(now_s: float, mode: FlightMode, by_pilot: bool = False) -> Ack:
        told.append(mode)
        return request(now_s, mode, by_pilot)

    autopilot.request_mode = counted

    def lift() -> None:
        harness.world.advance(asyncio.get_running_loop().time())
        autopilot.request_arm(harness.truth.time_s, True)
        autopilot.request_takeoff(harness.truth.time_s, 1.0)

    yield Stage(
        SimGuard(SimGuard.Config(), here),
        here.clock.now_ns,
        lift,
        lambda: harness.lost_vehicles.add(Role.SENDER),
        lambda: len(told),
        run_virtual,
    )


@contextmanager
def mavlink() -> Generator[Stage]:
    with bench() as own:
        yield Stage(
            GuardMavlink(GuardMavlinkConfig(f"udpin://127.0.0.1:{own.port}", BIND, 1), CONTEXT),
            CONTEXT.clock.now_ns,
            own.in_air,
            lambda: setattr(own.vehicle, "silent", True),
            lambda: len(own.commands(176, 21)),
            asyncio.run,
        )


WATCHED = pytest.mark.parametrize("stage_of", [sim, mavlink])
StageOf = Callable[[], contextlib.AbstractContextManager[Stage]]


async def seen(watched: Watched, condition: Callable[[GuardView], bool]) -> GuardView:
    async with asyncio.timeout(PATIENCE_S):
        while True:
            view = watched.view()
            if view is not None and condition(view):
                return view
            await asyncio.sleep(0.01)


async def settled(watched: Watched) -> GuardView:
    """The view once nothing more comes: what was under way has."""
    async with asyncio.timeout(PATIENCE_S):
        before, view = None, watched.view()
        while view is None or before is None or before.heartbeat_ns != view.heartbeat_ns:
            await asyncio.sleep(0.5)
            before, view = view, watched.view()
        return view


@WATCHED
def test_it_is_seen_and_each_command_is_said_once_and_its_answer_told(stage_of: StageOf) -> None:
    async def test(stage: Stage) -> None:
        async with stage.watched as watched:
            assert watched.name
            await seen(watched, lambda view: not view.armed)
            # its estimate has settled
            await asyncio.sleep(3.0 if stage.run is run_virtual else 0.5)
            stage.lift()
            views = [await seen(watched, lambda view: view.armed and view.in_air)]
            while len(views) < 20:
                views.append(await seen(watched, lambda _: True))
                await asyncio.sleep(0.01)
            assert all(
                later.heartbeat_ns >= earlier.heartbeat_ns for earlier, later in pairwise(views)
            )
            assert all(
                later.position_ns >= earlier.position_ns for earlier, later in pairwise(views)
            )
            assert stage.now_ns() >= views[-1].heartbeat_ns
            await seen(watched, lambda view: stage.now_ns() - view.heartbeat_ns < 2_000_000_000)
            assert views[-1].acked is None
            for command, mode in ((watched.hold, FlightMode.HOLD), (watched.land, FlightMode.LAND)):
                before = stage.told()
                command()
                view = await seen(
                    watched, lambda view, mode=mode: view.mode is mode and view.acked is not None
                )
                assert view.acked is True
                assert stage.told() == before + 1

    with stage_of() as stage:
        stage.run(test(stage))


@WATCHED
def test_of_one_that_is_silent_the_age_tells_and_commands_stay_unanswered(
    stage_of: StageOf,
) -> None:
    async def test(stage: Stage) -> None:
        async with stage.watched as watched:
            await seen(watched, lambda view: not view.armed)
            stage.silence()
            newest = await settled(watched)
            watched.hold()
            watched.land()
            await asyncio.sleep(0.3)
            view = watched.view()
            assert view is not None
            assert (view.heartbeat_ns, view.position_ns) == (
                newest.heartbeat_ns,
                newest.position_ns,
            )
            assert view.acked is None

    with stage_of() as stage:
        stage.run(test(stage))


@WATCHED
def test_what_is_not_open_sees_nothing_new_and_sends_nothing(stage_of: StageOf) -> None:
    async def test(stage: Stage) -> None:
        watched = stage.watched
        assert watched.view() is None
        watched.hold()
        watched.land()
        async with watched:
            await seen(watched, lambda view: not view.armed)
        view = watched.view()
        watched.hold()
        watched.land()
        await asyncio.sleep(0.3)
        again = watched.view()
        assert view is not None and again is not None
        assert again.heartbeat_ns == view.heartbeat_ns
        await watched.__aexit__(None, None, None)
        assert stage.told() == 0

    with stage_of() as stage:
        stage.run(test(stage))
