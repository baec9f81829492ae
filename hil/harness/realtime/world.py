"""The world of a run in real time, a process of its own: physics, vehicles on the wire, cameras,
links, faults.

    python -m hil.harness.<a world> RIG_FILE SEED ERRORS [MORE ...] -- [FOLDER ...]

Commands come in on stdin as lines of JSON: ``{"begin": true}`` once all programs are ready, from
which on the time of what is on the ground runs; ``{"fault": NAME, "leg": N, "ends": [SENDER,
RECEIVER], "drone": NAME, "value": X, "at_ns": T}``; ``{"finish": SECONDS}``, so long at most until
all are down; and what a world's drones are told besides. Events go out on stdout: ``warming``,
``ready``, and at last ``finished`` with the findings. A closed stdin ends it.
"""

from __future__ import annotations

import asyncio
import gc
import signal
import sys
import threading
import time
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from contextlib import AsyncExitStack, ExitStack
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from drivers.interfaces import PartError
from drivers.log.json_lines import JsonLines
from drivers.rig.file import load_rig
from drivers.rig.parts import Rig, with_errors
from hil.harness.inject import inject_on_link
from hil.harness.preparation import prepare
from hil.harness.realtime.pace import StolenTime
from hil.harness.realtime.parts import CameraThread, CameraView, FrameWriter, at_pace, running, say
from hil.link.faulty import UdpFaultProxy
from hil.vehicle.simulators.process import SimulatorBroken
from hil.world.errors import level_of
from hil.world.snapshot import Snapshot
from hil.world.world import Fleet

TRUTH_STEPS = 4
STALL_S = 0.1  # between two steps: a hundredth of that is usual
BETWEEN = "--"


class VehicleOnTheWire(Protocol):
    """An embedded autopilot, a Tello, or the way to a real autopilot. ``silent``: it hears nothing
    any more.
    """

    @property
    def silent(self) -> bool: ...

    @silent.setter
    def silent(self, silent: bool, /) -> None: ...

    def pump(self, now_s: float, /) -> None: ...

    def close(self) -> None: ...


@dataclass(slots=True)
class WorldDrone:
    """One drone in the world: its vehicle while it is on the wire, its camera while somebody may
    look.

    ``cut_off_s``: when the harness itself stopped its setpoints; ``frames``: rendered and left out,
    in all flights.
    """

    name: str
    vehicle: VehicleOnTheWire | None = None
    camera: ExitStack = field(default_factory=ExitStack)
    thread: CameraThread | None = None
    cut_off_s: list[float] = field(default_factory=list[float])
    frames: dict[str, int] = field(default_factory=lambda: {"rendered": 0, "left_out": 0})

    def close_camera(self) -> None:
        """Its thread may be drawing: this waits for it."""
        self.camera.close()
        if self.thread is not None:
            self.frames["rendered"] += self.thread.rendered
            self.frames["left_out"] += self.thread.left_out
            self.thread = None

    def close_vehicle(self) -> None:
        if self.vehicle is not None:
            self.vehicle.close()
            self.vehicle = None


class RealTimeWorld:
    """Any number of drones, called by names. A world says what they see, what is watched and what
    came of it.

    ``lock`` guards the truth: the cameras' threads look at it while physics steps it.
    """

    def __init__(self, rig: Rig, names: Sequence[str]) -> None:
        self.rig = rig
        self.drones = {name: WorldDrone(name) for name in names}
        self.proxies: dict[int, UdpFaultProxy] = {}
        self.frozen: set[str] = set()
        self.start_s = 0.0
        # the longest time between two steps while a drone flew: neither vehicles nor monitors lived
        self.stood_s = 0.0
        # from when to when it stood still, s of its own clock
        self.stalls: list[tuple[float, float]] = []
        self.stolen = StolenTime()
        self.lock = threading.Lock()
        self._commands = JsonLines(sys.stdin.fileno())
        self._orders: asyncio.Queue[dict[str, Any]] = asyncio.Queue()
        self._finish_by_s: float | None = None

    # --- what each world says for itself ---

    @property
    @abstractmethod
    def fleet(self) -> Fleet: ...

    @abstractmethod
    async def open(self, stack: AsyncExitStack) -> Mapping[str, Any]:
        """Open what is there from the start, and start the clock. Returns what the parent has to
        know of it.
        """

    @abstractmethod
    def seen_by(self, name: str) -> Snapshot:
        """The truth now, as far as a drone's camera is concerned."""

    @abstractmethod
    def landed(self) -> bool: ...

    @abstractmethod
    def inject(self, order: Mapping[str, Any], at_s: float) -> None:
        """A fault that is of the world itself."""

    @abstractmethod
    def watch(self, steps: int, now_s: float) -> None:
        """After each step of physics, with the lock held."""

    @abstractmethod
    def findings(self) -> dict[str, Any]: ...

    def after_step(self, now_s: float) -> None:
        """After each step, without the lock."""

    def record(self, name: str, topic: str, stamp_ns: int, record: dict[str, Any]) -> None:
        """A drone's program logged something that is watched."""

    async def obey(self, order: Mapping[str, Any]) -> None:
        """An order that only this world knows."""
        raise ValueError(f"the world knows no command {order}")

    # --- the run ---

    def now_s(self) -> float:
        return self.when_s(time.monotonic())

    def when_s(self, monotonic_s: float) -> float:
        """The world's time of an instant of the monotonic clock."""
        return monotonic_s - self.start_s

    async def run(self) -> None:
        prepare(self.rig, lambda what: say({"event": "warming", "what": what}))
        async with AsyncExitStack() as stack:
            stack.push_async_callback(self._close)
            ready = await self.open(stack)
            # what is loaded by now stays: a full collection would stop the world for 0.1 s
            gc.freeze()
            asyncio.get_running_loop().add_reader(sys.stdin.fileno(), self._on_input)
            say({"event": "ready", **ready})
            tasks = (
                asyncio.ensure_future(at_pace(self.now_s, self.step)),
                asyncio.ensure_future(self._obey_in_order()),
            )
            for task in tasks:
                stack.callback(task.cancel)
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                task.result()  # an order that cannot be carried out ends the world
            for drone in self.drones.values():
                drone.close_camera()
            frames = {name: drone.frames for name, drone in self.drones.items()}
            late = {"stood_s": self.stood_s, "stolen_s": self.stolen.longest_s}
            say({"event": "finished", **self.findings(), "frames": frames, **late})

    def step(self, steps: int) -> bool:
        """The world as it is by now. Returns whether it is over."""
        now_s = self.now_s()
        fleet = self.fleet
        with self.lock:
            if not self.landed():
                self._note_stall(fleet.time_s, now_s)
                self.stolen.watch(now_s)
            fleet.advance(max(now_s, fleet.time_s))
            for drone in self.drones.values():
                if drone.vehicle is not None:
                    drone.vehicle.pump(fleet.time_s)
            self.watch(steps, now_s)
        self.after_step(now_s)
        return self._finish_by_s is not None and (self.landed() or now_s > self._finish_by_s)

    def _note_stall(self, stepped_s: float, now_s: float) -> None:
        self.stood_s = max(self.stood_s, now_s - stepped_s)
        if now_s - stepped_s > STALL_S:
            self.stalls.append((stepped_s, now_s))

    async def _close(self) -> None:
        for drone in self.drones.values():
            drone.close_camera()
            drone.close_vehicle()
        for proxy in self.proxies.values():
            await proxy.__aexit__(None, None, None)

    # --- cameras ---

    def start_camera(
        self, name: str, picture: CameraView, writer: FrameWriter, rate_hz: float, phase: float
    ) -> None:
        drone = self.drones[name]
        out = drone.camera.enter_context(writer)
        look = partial(self._look_as, name)
        drone.thread = CameraThread(self.now_s, look, picture, out, rate_hz, phase)
        drone.camera.enter_context(running(drone.thread))

    def _look_as(self, name: str) -> tuple[int, Snapshot] | None:
        """Return the world as one drone's camera sees it now."""
        if name in self.frozen:
            return None
        with self.lock:
            self.fleet.advance(max(self.now_s(), self.fleet.time_s))
            seen = self.seen_by(name)
        return round((self.start_s + seen.time_s) * 1e9), seen

    # --- commands ---

    def _on_input(self) -> None:
        commands = self._commands.read()
        if commands is None:
            asyncio.get_running_loop().remove_reader(sys.stdin.fileno())
            self._finish_by_s = 0.0
            return
        for command in commands:
            if "record" in command:
                self.record(*command["record"])
            else:
                self._orders.put_nowait(command)

    async def _obey_in_order(self) -> None:
        while True:
            order = await self._orders.get()
            if "fault" in order:
                self._inject(order)
            elif "finish" in order:
                self._finish_by_s = self.now_s() + float(order["finish"])
            elif "begin" in order:
                with self.lock:
                    self.fleet.begin_traffic()
            else:
                await self.obey(order)

    def _inject(self, order: Mapping[str, Any]) -> None:
        fault = order["fault"]
        at_s = int(order["at_ns"]) * 1e-9 - self.start_s
        if order["leg"] in self.proxies:
            inject_on_link(fault, order["value"] or 0.0, self.proxies[order["leg"]])
        with self.lock:
            self.inject(order, at_s)
        if order["drone"] is None:
            return
        drone = self.drones[order["drone"]]
        if fault == "camera_freeze":
            self.frozen.add(drone.name)
        if fault == "fc_link_loss" and drone.vehicle is not None:
            drone.vehicle.silent = True
        if fault.startswith(("kill_", "stop_", "stall_")) or fault == "fc_link_loss":
            drone.cut_off_s.append(at_s)


def world_command(module: str, rig: Rig, seed: int, *more: str) -> Sequence[str]:
    """Return the command of a world's process."""
    own = [str(rig.file), str(seed), level_of(rig), *more, BETWEEN, *map(str, rig.folders)]
    return [sys.executable, "-m", module, *own]


def main(world: type[RealTimeWorld]) -> None:
    """The program of a world's process; ``world`` is made of its rig, seed and what more was
    said.
    """
    between = sys.argv.index(BETWEEN)
    rig_file, seed, errors, *more = sys.argv[1:between]
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides when this process ends
    try:
        rig = with_errors(
            load_rig(rig_file, [Path(folder) for folder in sys.argv[between + 1 :]]), errors
        )
        made: Any = world
        asyncio.run(made(rig, int(seed), *more).run())
    except (SimulatorBroken, PartError) as error:
        say({"event": "failed", "what": str(error)})
        sys.exit(1)
