"""The contract of every vehicle, as tests for a driver of one's own.

    class TestMine(VehicleContract):
        def stage(self):
            ...  # a context manager that gives a Stage

pytest collects the tests of the class. They fly the driver against its far side: an emulator, or
what stands in for one. Needs pytest.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import pytest

from drivers.interfaces import (
    Capability,
    Clock,
    FlightMode,
    Vehicle,
    VehicleError,
    VelocitySetpoint,
    lacking,
)

STILL = VelocitySetpoint((0.0, 0.0, 0.0), 0.0)
HEIGHT_M = 0.9
PATIENCE_S = 60.0
LOST_S = 20.0  # any call's bound once the far side is gone; the machine may be busy
FRESH_NS = 1_000_000_000


@dataclass
class Stage:
    """A vehicle, closed, and what is known of its far side.

    Attributes:
        clock: of the role.
        on_ground: whether it stands there, in truth.
        unplug: nothing passes any more, either way; without setpoints it has to come down by itself.
        heard: how many commands and setpoints have come to the far side.
        run: a coroutine on a real or a virtual loop, such as ``asyncio.run``.
    """

    vehicle: Vehicle
    clock: Clock
    on_ground: Callable[[], bool]
    unplug: Callable[[], object]
    heard: Callable[[], int]
    run: Callable[[Any], Any]


class VehicleContract:
    """What ``drivers.interfaces.Vehicle`` asks of a driver, a test each."""

    def stage(self) -> AbstractContextManager[Stage]:
        """Give a vehicle with a far side that stands on the ground, ready to be armed soon."""
        raise NotImplementedError

    def _on(self, test: Callable[[Stage], Awaitable[None]]) -> None:
        with self.stage() as stage:
            stage.run(test(stage))

    def test_before_it_is_open_everything_is_refused_and_nothing_sent(self) -> None:
        async def test(stage: Stage) -> None:
            await refuses_all(stage)
            with pytest.raises(VehicleError):
                _ = stage.vehicle.state
            with pytest.raises(VehicleError):
                stage.vehicle.attitude_at(0)

        self._on(test)

    def test_state_stamps_never_go_back_and_are_of_the_role_s_clock(self) -> None:
        async def test(stage: Stage) -> None:
            async with stage.vehicle as vehicle:
                await vehicle.wait_armable(PATIENCE_S)
                states, fresh = [vehicle.state], [0]

                def look() -> None:
                    state = vehicle.state
                    ages_ns = [
                        stage.clock.now_ns() - stamp_ns
                        for stamp_ns in (state.stamp_ns, state.heartbeat_ns)
                    ]
                    assert min(ages_ns) >= -20_000_000
                    states.append(state)
                    fresh[0] += max(ages_ns) < FRESH_NS  # older where this process stood still

                await until(
                    lambda: len({state.stamp_ns for state in states}) > 4 and fresh[0] > 4, look
                )
                for earlier, later in pairwise(states):
                    assert later.stamp_ns >= earlier.stamp_ns
                    assert later.heartbeat_ns >= earlier.heartbeat_ns
                for state in states:
                    assert math.hypot(*state.q_n_b) == pytest.approx(1.0, abs=1e-3)
                    assert 0.0 <= state.battery <= 1.0
                    assert (state.armed, state.in_air, state.armable) == (False, False, True)
                newest = vehicle.state
                assert vehicle.attitude_at(newest.stamp_ns + 10**9) == pytest.approx(
                    newest.q_n_b, abs=0.05
                )

        self._on(test)

    def test_on_the_ground_what_makes_no_sense_is_refused_and_moves_nothing(self) -> None:
        async def test(stage: Stage) -> None:
            async with stage.vehicle as vehicle:
                await vehicle.wait_armable(PATIENCE_S)
                with pytest.raises(VehicleError, match="not armed"):
                    await vehicle.take_off(HEIGHT_M, 2.0)
                await vehicle.land(2.0)  # it is down
                with pytest.raises(VehicleError, match="not finite"):
                    vehicle.fly(VelocitySetpoint((0.0, math.nan, 0.0), 0.0))
                with pytest.raises(VehicleError, match="not finite"):
                    vehicle.fly(VelocitySetpoint((0.0, 0.0, 0.0), math.inf))
                await vehicle.arm()
                for height_m in (math.nan, 0.0, -1.0):
                    with pytest.raises(VehicleError, match="height"):
                        await vehicle.take_off(height_m, 2.0)
                assert stage.on_ground()

        self._on(test)

    def test_closing_is_quick_and_once_and_nothing_is_sent_after_it_and_it_opens_again(
        self,
    ) -> None:
        async def test(stage: Stage) -> None:
            loop = asyncio.get_running_loop()
            async with stage.vehicle as vehicle:
                assert not vehicle.state.armed
                start_s = loop.time()
            assert loop.time() - start_s < LOST_S
            await vehicle.__aexit__(None, None, None)
            await refuses_all(stage)
            async with stage.vehicle:
                stamp_ns = vehicle.state.stamp_ns
                await until(lambda: vehicle.state.stamp_ns > stamp_ns)

        self._on(test)

    def test_a_flight_shows_what_was_told_and_then_a_far_side_that_is_lost_ends_every_call(
        self,
    ) -> None:
        async def test(stage: Stage) -> None:
            loop = asyncio.get_running_loop()
            async with stage.vehicle as vehicle:
                await up(vehicle)
                state = vehicle.state
                assert (state.armed, state.in_air, state.mode) == (True, True, FlightMode.HOLD)
                assert not stage.on_ground()
                await vehicle.start_offboard(STILL)
                assert vehicle.state.mode is FlightMode.OFFBOARD
                # far enough from its north, and to where its own axes are its start's
                await until(
                    lambda: vehicle.state.velocity_n_mps[0] > 0.25,
                    lambda: vehicle.fly(VelocitySetpoint((0.5, 0.0, 0.0), 0.0)),
                )
                says_where(vehicle)
                stage.unplug()
                for command in (
                    vehicle.hold,
                    lambda: vehicle.land(PATIENCE_S),
                    lambda: vehicle.wait_armable(PATIENCE_S),
                ):
                    start_s = loop.time()
                    with pytest.raises(VehicleError) as caught:
                        await command()
                    assert caught.value.remedy
                    assert loop.time() - start_s < LOST_S
                # still answers, is not made to look younger, and nobody has seen it land
                await until(
                    lambda: stage.clock.now_ns() - vehicle.state.heartbeat_ns > 1_500_000_000
                )
                await until(lambda: stage.clock.now_ns() - vehicle.state.stamp_ns > 1_500_000_000)
                assert vehicle.state.armed
                await until(stage.on_ground)  # by its own failsafe
                start_s = loop.time()
            assert loop.time() - start_s < LOST_S

        self._on(test)


async def until(condition: Callable[[], bool], each: Callable[[], None] = lambda: None) -> None:
    async with asyncio.timeout(PATIENCE_S):
        while not condition():
            each()
            await asyncio.sleep(0.02)


async def up(vehicle: Vehicle) -> None:
    await vehicle.wait_armable(PATIENCE_S)
    await vehicle.arm()
    await vehicle.take_off(HEIGHT_M, PATIENCE_S)


def commands(vehicle: Vehicle) -> list[Callable[[], Awaitable[None]]]:
    return [
        lambda: vehicle.wait_armable(0.5),
        vehicle.arm,
        lambda: vehicle.take_off(HEIGHT_M, 0.5),
        lambda: vehicle.start_offboard(STILL),
        vehicle.hold,
        lambda: vehicle.land(0.5),
    ]


async def refuses_all(stage: Stage) -> None:
    """Every call is refused, says what to do, and sends nothing."""
    heard = stage.heard()
    for command in commands(stage.vehicle):
        with pytest.raises(VehicleError) as caught:
            await command()
        assert caught.value.remedy
    with pytest.raises(VehicleError) as caught:
        stage.vehicle.fly(STILL)
    assert caught.value.remedy
    await asyncio.sleep(0.1)  # what was sent would have come by now
    assert stage.heard() == heard


def says_where(vehicle: Vehicle) -> None:
    """A position that drifts comes with how far it may be off, any other without."""
    drifts = Capability.GLOBAL_POSITION in lacking(vehicle)
    sigma_m = vehicle.state.position_sigma_m
    assert (sigma_m is not None) == drifts
    assert sigma_m is None or sigma_m > 0.0
