"""The emulated Tello flown by a program that knows nothing of PATH, and is stricter than
djitellopy: tello-asyncio.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterator
from typing import Any

import pytest
import tello_asyncio.tello as stranger  # type: ignore[import-untyped]
from tello_asyncio import Direction, Vector

from hil.tello.emulator import TelloEmulator, TelloEmulatorConfig
from hil.world.config import WorldConfig
from hil.world.world import SimDrone, World
from path.messages import Role
from tests.free_ports import free_host, free_port

HOST = free_host()
STEP_S = 0.005
PATIENCE_S = 120.0  # for an answer; its own 10 s are a drone's, and this one's time is a computer's


class OneComputer:
    """An event loop that binds to any port: on one computer drone and program cannot both have
    8889.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop

    def __getattr__(self, name: str) -> Any:
        return getattr(self._loop, name)

    async def create_datagram_endpoint(
        self, protocol: Any, local_addr: Any, remote_addr: Any = None
    ) -> Any:
        local = local_addr if remote_addr is None else ("127.0.0.1", 0)
        return await self._loop.create_datagram_endpoint(
            protocol, local_addr=local, remote_addr=remote_addr
        )


@pytest.fixture
def drone(monkeypatch: pytest.MonkeyPatch) -> Iterator[SimDrone]:
    """The drone behind an emulator whose time runs four times as fast; its state packets go to a
    port that is free.
    """
    state = free_port()
    monkeypatch.setattr(stranger, "STATE_UDP_PORT", state)
    monkeypatch.setattr(stranger.Tello.send, "__defaults__", (PATIENCE_S, None))
    world = World(WorldConfig(), seed=3)
    emulator = TelloEmulator(TelloEmulatorConfig(HOST), world.drone(Role.SENDER))
    emulator._ports = (state, emulator._ports[1])
    world.advance(3.0)
    ending = threading.Event()

    def step() -> None:
        while not ending.wait(STEP_S / 4.0):
            world.advance(world.time_s + STEP_S)
            emulator.pump(world.time_s)

    thread = threading.Thread(target=step)
    thread.start()
    yield world.drone(Role.SENDER)
    ending.set()
    thread.join()
    emulator.close()


def test_tello_asyncio_flies_it(drone: SimDrone) -> None:
    """Its "ok" is two bytes, a query's answer a whole number; every move ends in a hover."""

    async def fly() -> Any:
        tello: Any = stranger.Tello(drone_host=HOST)
        tello._loop = OneComputer(tello._loop)
        await tello.connect()
        assert 0 <= await tello.query_battery() <= 100
        assert await tello.sdk_version == "30\r\n"
        await tello.takeoff()
        assert drone.true_position_n_m[2] < -0.5
        await tello.move(Direction.UP, 40)
        await tello.turn_clockwise(90)
        await tello.go_to(Vector(60, 0, 0), 50)
        await tello.curve_to(Vector(60, 60, 0), Vector(120, 0, 0), 40)
        await tello.flip_forward()
        await tello.enable_mission_pads()
        with pytest.raises(stranger.Tello.Error, match="out of range"):
            await tello.move_forward(501)
        state = tello.state
        await tello.land()
        await tello.disconnect()
        return state

    state = asyncio.run(asyncio.wait_for(fly(), 4.0 * PATIENCE_S))
    assert state.yaw == pytest.approx(90, abs=8)
    assert 0 < state.battery <= 100
    assert drone.on_ground
    assert drone.true_position_n_m[1] > 0.9, "forward was east after the turn"
