"""An emulated Tello on a loopback address of its own, stepped in a thread, and the drivers' context
to go with it.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from drivers.clock import SystemClock
from drivers.rig.parts import Mount, Origin, PartContext
from hil.tello.emulator import TelloEmulator, TelloEmulatorConfig
from hil.tello.video import TelloVideo, TelloVideoConfig
from hil.world.config import WorldConfig
from hil.world.world import SimDrone, World
from path.camera.model import CameraModel
from path.geometry.transforms import Pose
from path.marker.layout import single_marker
from path.messages import Role
from tests.free_ports import free_host, free_port
from tests.steady_time import SteadyTime

CAMERA = CameraModel(320, 240, 300.0, 300.0, 159.5, 119.5)
LEVEL = Mount(Pose(np.eye(3), np.zeros(3)), Pose(np.eye(3), np.zeros(3)))
STEP_S = 0.005
STATE_PORT = free_port()
"""djitellopy listens on one for all drones of a process, from the first on."""


def context() -> PartContext:
    none: Any = None
    clock = SystemClock(SystemClock.Config(), none)
    return PartContext(Role.SENDER, clock, CAMERA, LEVEL, single_marker(), Origin(47.0, 8.0, 400.0))


@dataclass
class Stand:
    """The drone's far side. ``address`` are the options that find it."""

    emulator: TelloEmulator
    video: TelloVideo
    drone: SimDrone
    address: dict[str, Any]
    lock: threading.Lock = field(default_factory=threading.Lock)
    heard: list[str] = field(default_factory=list[str])

    def count(self, word: str) -> int:
        return self.emulator.received[word]


async def until(condition: Callable[[], bool], limit_s: float = 60.0) -> None:
    """Poll for a condition; TimeoutError when it does not come true."""
    end_s = time.monotonic() + limit_s
    while not condition():
        if time.monotonic() > end_s:
            raise TimeoutError
        await asyncio.sleep(0.01)


@contextmanager
def emulated(
    config: dict[str, Any] | None = None, rate_hz: float = 0.0, speed: float = 1.0
) -> Generator[Stand]:
    """One Tello; its time runs ``speed`` times as fast as ours. With a rate its camera films a
    clock.
    """
    world = World(WorldConfig(), seed=3)
    host = free_host()
    drone = world.drone(Role.SENDER)
    camera = TelloVideo(TelloVideoConfig(CAMERA.width, CAMERA.height, rate_hz or 30.0))
    emulator = TelloEmulator(TelloEmulatorConfig(host, **(config or {})), drone, camera)
    stand = Stand(
        emulator, camera, drone, {"host": host, "state_port": STATE_PORT, "video_port": free_port()}
    )
    emulator.tap = lambda _, text: stand.heard.append(text)
    world.advance(3.0)  # its estimate has settled
    start_s, ending, passed = time.monotonic(), threading.Event(), SteadyTime(speed, 3.0)

    def step() -> None:
        frames = 0
        while not ending.is_set():
            with stand.lock:
                world.advance(max(passed.now_s(), world.time_s))
                emulator.pump(world.time_s)
            if rate_hz and time.monotonic() - start_s > frames / rate_hz:
                frames += 1
                stamp_ns = time.monotonic_ns()
                camera.write(stamp_ns, time_code(stamp_ns))
            camera.pump(time.monotonic())
            time.sleep(STEP_S)

    thread = threading.Thread(target=step, name="tello-stand")
    thread.start()
    try:
        yield stand
    finally:
        ending.set()
        thread.join()
        emulator.close()


CODE_BITS, CELL = 24, 20


def time_code(stamp_ns: int) -> np.ndarray[Any, np.dtype[np.uint8]]:
    """An image that shows its stamp, in milliseconds, as black and white squares."""
    image = np.full((CAMERA.height, CAMERA.width, 3), 90, np.uint8)
    value = (stamp_ns // 1_000_000) % (1 << CODE_BITS)
    for bit in range(CODE_BITS):
        row, column = divmod(bit, 12)
        level = 230 if value >> bit & 1 else 20
        image[40 + row * 60 : 40 + row * 60 + CELL, 20 + column * 23 : 20 + column * 23 + CELL] = (
            level
        )
    return image


def age_of(image: np.ndarray[Any, np.dtype[np.uint8]], at_ns: int) -> float:
    """Returns how long before ``at_ns`` the image was taken, s, by the code in it."""
    value = 0
    for bit in range(CODE_BITS):
        row, column = divmod(bit, 12)
        y, x = 40 + row * 60 + CELL // 2, 20 + column * 23 + CELL // 2
        value |= (int(image[y, x].mean()) > 128) << bit
    passed_ms = (at_ns // 1_000_000 - value) % (1 << CODE_BITS)
    return passed_ms * 1e-3


def code_is_whole(image: np.ndarray[Any, np.dtype[np.uint8]]) -> bool:
    """Returns whether every square is clearly black or white."""
    for bit in range(CODE_BITS):
        row, column = divmod(bit, 12)
        inner = image[
            44 + row * 60 : 36 + row * 60 + CELL, 24 + column * 23 : 16 + column * 23 + CELL
        ].astype(int)
        if not (inner.min() > 180 or inner.max() < 70):
            return False
    return True
