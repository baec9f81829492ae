"""The ceiling in truth, with a GPS altitude that is off, drifts and jumps: a guard alone over its
own MAVLink.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Sequence
from contextlib import ExitStack
from dataclasses import replace
from typing import Any

from drivers.interfaces import FlightMode, VelocitySetpoint
from drivers.mavlink.guard.interfaces import Beat, GuardAnswer, Script
from drivers.mavlink.guard_link import GuardMavlink, GuardMavlinkConfig
from flight.config import GuardConfig, MissionConfig
from flight.guard.rules import GuardStage
from flight.guard.watch import GuardWatch, watch
from hil.world.config import AltitudeConfig
from tests.doubles import NoLog
from tests.drivers.mavlink.test_guard_link import BIND, CONTEXT, seen
from tests.guard_bench import LIMIT_S, SYSID, Bench, bench

CEILING_M = 2.0
MISSION = MissionConfig(guard=GuardConfig(fence_height_m=CEILING_M))
CLIMB = VelocitySetpoint((0.0, 0.0, -0.5), 0.0)
ALTITUDES = (
    AltitudeConfig(offset_m=10.0, drift_mps=0.3),
    AltitudeConfig(offset_m=-10.0, drift_mps=-0.3),
    # a PX4 indoors, its origin at sea level: in the air
    AltitudeConfig(jump_m=-488.0, jump_after_s=4.0),
)


class Beating:
    """The line of a program that lives, sends setpoints and looks at no limit; or of one that is
    dead.
    """

    def __init__(self) -> None:
        self.alive, self.beats, self.script = True, 0, Script.CLIMB
        self.ignored: dict[str, int] = {}

    async def __aenter__(self) -> Beating:
        return self

    async def __aexit__(self, *_: object) -> None: ...

    def newest(self) -> tuple[int, Beat] | None:
        self.beats += 1
        return (CONTEXT.clock.now_ns(), Beat(self.script, self.beats)) if self.alive else None

    def answer(self, answer: GuardAnswer) -> None: ...


def height_m(own: Bench) -> float:
    with own.lock:
        return -own.drone.true_position_n_m[2] - 0.1


def with_each_altitude(fly: Callable[[Bench], Coroutine[Any, Any, None]]) -> None:
    """All at once: a flight waits more than it computes."""

    async def main(benches: Sequence[Bench]) -> None:
        await asyncio.gather(*map(fly, benches))

    with ExitStack() as stack:
        benches = [stack.enter_context(bench(altitude=altitude)) for altitude in ALTITUDES]
        asyncio.run(main(benches))


async def on_the_ground(vehicle: GuardMavlink) -> None:
    """What it stands on has been seen."""
    await seen(vehicle, lambda view: view.position_ns > 0)
    await asyncio.sleep(1.0)


def test_a_healthy_drone_is_left_alone_and_the_ceiling_is_kept_in_truth() -> None:
    """A script that climbs and looks at nothing; then, anew, one that is dead."""

    async def fly(own: Bench) -> None:
        config = GuardMavlinkConfig(
            f"udpin://127.0.0.1:{own.port}", BIND, SYSID, height_from="home"
        )
        line, ended = Beating(), asyncio.Event()
        async with GuardMavlink(config, CONTEXT) as vehicle:
            guard = GuardWatch(vehicle, line, CONTEXT.clock, MISSION, NoLog())
            watching = asyncio.create_task(watch((guard,), ended))
            await on_the_ground(vehicle)
            await asyncio.to_thread(own.in_air)
            line.script = Script.CONTROL
            await asyncio.sleep(4.0)
            assert guard.state.stage is GuardStage.WATCHING, guard.state.reason
            own.flown, highest_m = CLIMB, 0.0
            while guard.state.stage is GuardStage.WATCHING and highest_m < 2.0 * CEILING_M:
                highest_m = max(highest_m, height_m(own))
                await asyncio.sleep(0.02)
            assert "outside the fence" in guard.state.reason
            # half a second of patience at 0.5 m/s, and telemetry
            assert CEILING_M - 0.3 < highest_m < CEILING_M + 0.8
            async with asyncio.timeout(LIMIT_S):
                while own.autopilot.armed:
                    highest_m = max(highest_m, height_m(own))
                    await asyncio.sleep(0.02)
            assert highest_m < CEILING_M + 1.0
            ended.set()
            await watching

    with_each_altitude(fly)


def test_a_dead_scripts_vehicle_is_held_where_it_truly_is() -> None:
    async def fly(own: Bench) -> None:
        config = GuardMavlinkConfig(
            f"udpin://127.0.0.1:{own.port}", BIND, SYSID, height_from="home"
        )
        line, ended = Beating(), asyncio.Event()
        async with GuardMavlink(config, CONTEXT) as vehicle:
            guard = GuardWatch(vehicle, line, CONTEXT.clock, MISSION, NoLog())
            watching = asyncio.create_task(watch((guard,), ended))
            await on_the_ground(vehicle)
            await asyncio.to_thread(own.in_air)
            line.script = Script.CONTROL
            beats, begun_s = line.beats, own.world.time_s
            while line.beats < beats + 3 or own.world.time_s < begun_s + 0.5:  # they have said so  # noqa: ASYNC110
                await asyncio.sleep(0.02)
            own.flown = CLIMB
            line.alive = False  # MAVSDK's own thread goes on with its last setpoint
            highest_m = 0.0
            while own.autopilot.mode is FlightMode.OFFBOARD:
                highest_m = max(highest_m, height_m(own))
                await asyncio.sleep(0.02)
            assert "no sign of life" in guard.state.reason
            assert highest_m < CEILING_M
            ended.set()
            watching.cancel()

    with_each_altitude(fly)


def test_what_an_altitude_is_wrong_by() -> None:
    off = AltitudeConfig(offset_m=10.0, drift_mps=0.5, drift_most_m=2.0)
    assert [off.error_m(number, time_s) for number, time_s in ((0, 0.0), (1, 0.0), (0, 2.0), (0, 60.0), (1, 60.0))] == [
        10.0, -10.0, 11.0, 12.0, -12.0,
    ]  # fmt: skip
    indoors = replace(AltitudeConfig(), jump_m=-488.0, jump_after_s=5.0)
    assert (indoors.error_m(0, 4.9), indoors.error_m(1, 5.0)) == (0.0, -488.0)
