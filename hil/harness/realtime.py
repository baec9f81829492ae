"""Real time: the world, N named drones' programs and their guards as processes; started, killed and ended here.

One harness for every mission, which it knows nothing of. ``RealTimeRun.run`` is a run from top to bottom: the world
is started, the mission is flown, the world lands everybody and says what it found, and nothing is left behind. The
mission begins programs by their drones' names (``fly``) and opens legs; faults begin in their legs by themselves. In
virtual time ``hil.harness.programs`` does the same with programs that are tasks.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import resource
import signal
import time
from collections.abc import Awaitable, Callable, Coroutine, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from drivers.stop_signals import leave_signals, stop_on_signals
from flight.harness.flights import Emit, Progress, RoleResult, decode_event
from hil.harness.children import (
    Child,
    HarnessFailure,
    WorldTooSlow,
    drain,
    duty_of,
    end,
    end_gently,
    finish_world,
    go_on,
    kill_after,
    last_words,
    read_world,
    run_name,
    send_signal,
    spawn,
    until_ready,
    write,
)
from hil.harness.leg_faults import LegFaults
from hil.harness.preparation import starting
from hil.world.faults import Fault
from path.messages import Role

NEWS_S = 0.05
RECORD_POLL_S = 0.001
PROGRAM_END_S = 90.0  # from being told to stop until it has landed
RECORD = b'{"event":"record"'
"""How a line begins that the world's monitors are to judge."""

Command = Sequence[str]


def no_news(name: str) -> Mapping[str, Any]:
    """The news of a program that was told everything when it was started."""
    del name
    return {}


@dataclass(frozen=True, slots=True)
class Orders:
    """What is to be run.

    Attributes:
        world, program, guard: commands; the guard's is None for a drone without one.
        out: the run's folder.
        emit: shown the progress of every program.
        shares: the name of what a drone's program shares with the world.
        news: what a drone's program has to know at present; it is told on its stdin whenever that changes.
        heard: takes any other line of JSON that a program prints.
        attack: the command of a program that floods the link with so many packets a second, once the world said where.
        awaited: the world's traffic stands until the programs of all these drones have reported.
    """

    world: Command
    program: Callable[[str], Command]
    guard: Callable[[str], Command | None]
    out: Path
    emit: Emit
    shares: Callable[[str], str] = lambda _: run_name()
    news: Callable[[str], Mapping[str, Any]] = no_news
    heard: Callable[[str, Mapping[str, Any]], None] = lambda _name, _word: None
    attack: Callable[[float, Mapping[str, Any]], Command] = lambda _rate, _ready: ()
    awaited: frozenset[str] = frozenset()


@dataclass(slots=True)
class LiveDrone:
    """One drone's processes.

    Attributes:
        guard_ends: the end of the guard of the flight before.
        killed, restart_s: by a fault; and after how long its program is started again.
        told: the news that its program knows.
        result: what its newest program said in the end; None: it died, or still flies.
    """

    name: str
    program: Child | None = None
    guard: Child | None = None
    guard_ends: asyncio.Future[None] | None = None
    killed: bool = False
    restart_s: float | None = None
    told: Mapping[str, Any] = field(default_factory=dict[str, Any])
    result: RoleResult | None = None


@dataclass(frozen=True, slots=True)
class Ending:
    """The world's findings, {} when it gave none; why the run failed, and whether because all was too slow.

    ``cpu_s``: of all its processes.
    """

    finished: Mapping[str, Any]
    failure: str
    slow: str
    wall_s: float
    cpu_s: float


class RealTimeRun:
    """One run in real time.

    Args:
        faults: by the number of their leg; of 0 those of all legs.

    Attributes:
        stop: tells the mission to land everybody; ``interrupted``: whether it was told.
        said: the newest event of each kind that the world said.
    """

    def __init__(self, orders: Orders, names: Sequence[str], faults: Mapping[int, Sequence[Fault]]) -> None:
        self._orders = orders
        self.drones = {name: LiveDrone(name) for name in names}
        self.legs = LegFaults(faults, self._inject)
        self.stop = asyncio.Event()
        self.interrupted = False
        self.said: dict[str, dict[str, Any]] = {}
        self.children: list[Child] = []
        self.world: Child
        self._awaited = set(orders.awaited)
        self._coming: set[asyncio.Task[Any]] = set()

    async def run(self, mission: Callable[[], Coroutine[Any, Any, None]], limit_s: float, landing_s: float) -> Ending:
        """From the start of the world to its findings. Whatever happens, no process outlives it.

        Args:
            limit_s: what the mission may take before everybody is told to land.
            landing_s: what the vehicles are given to be down after it.
        """
        start_s, cpu_s, failure, slow, finished = time.monotonic(), _children_s(), "", "", dict[str, Any]()
        try:
            await self._start_world()
            await self._fly_until(asyncio.ensure_future(mission()), limit_s)
            finished = await finish_world(self.world, landing_s)
        except WorldTooSlow as error:
            failure = slow = str(error)
        except HarnessFailure as error:
            failure = str(error)
        finally:
            await self.close()
        failure = failure or ("" if finished else "the world gave no findings")
        return Ending(finished, failure, slow, time.monotonic() - start_s, _children_s() - cpu_s)

    async def _start_world(self) -> None:
        def warming(what: str) -> None:
            for role in Role:
                self._orders.emit(starting(role, what))

        self.world = await self.spawn(self._orders.world, "world")
        self.said["ready"] = await until_ready(self.world, warming)

    async def _fly_until(self, mission: asyncio.Future[None], limit_s: float) -> None:
        """Until the mission is over. Raises HarnessFailure when the world fails, or it takes far too long."""
        stop_on_signals(self.interrupt)
        beside = [asyncio.ensure_future(each) for each in (self._watch_world(), self._watch_records())]
        if self._orders.news is not no_news:
            beside.append(asyncio.ensure_future(self._tell_news()))
        try:
            done, _ = await asyncio.wait([mission, *beside], timeout=limit_s, return_when=asyncio.FIRST_COMPLETED)
            if not done:
                self.interrupt()
                await asyncio.wait([mission], timeout=PROGRAM_END_S)
                raise HarnessFailure(f"the run did not end within {limit_s:.0f} s")
            for task in done:
                task.result()
        finally:
            self.legs.close()
            for task in (mission, *beside):
                task.cancel()
            await asyncio.gather(mission, *beside, return_exceptions=True)
            leave_signals()

    async def close(self) -> None:
        for task in self._coming:
            task.cancel()
        await asyncio.gather(*self._coming, return_exceptions=True)
        await end(self.children)

    # --- what a mission does ---

    async def fly(self, name: str) -> RoleResult | None:
        """A drone's program to its end; killed by a fault it is started again, when the fault says so.

        Returns what it said in the end; None when it died.
        """
        drone = self.drones[name]
        while True:
            drone.killed, drone.told, drone.restart_s, drone.result = False, {}, None, None
            drone.program = await self.spawn(self._orders.program(name), name, self._orders.shares(name))
            if self.stop.is_set():
                send_signal(drone.program, signal.SIGTERM)
            await self._listen(drone, drone.program)
            if drone.result is not None or drone.restart_s is None:
                return drone.result
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self.stop.wait(), drone.restart_s)
            if self.stop.is_set():
                return None

    async def start_guard(self, name: str) -> None:
        """Beside the programs of one flight, in a rig with guards; that of the flight before has ended by then."""
        drone, command = self.drones[name], self._orders.guard(name)
        if drone.guard_ends is not None:
            await drone.guard_ends
        if command is not None and drone.guard is None:
            drone.guard = await self.spawn(command, f"{name}.guard", self._orders.shares(name))
            self._later(drain(drone.guard))

    def end_guard(self, name: str) -> None:
        drone = self.drones[name]
        if drone.guard is not None:
            drone.guard_ends, drone.guard = asyncio.ensure_future(end_gently(drone.guard)), None

    def tell_world(self, command: Mapping[str, Any]) -> None:
        write(self.world, json.dumps(command).encode() + b"\n")

    def interrupt(self) -> None:
        """Gently: they land."""
        self.interrupted = True
        self.stop.set()
        for drone in self.drones.values():
            drone.restart_s = None
            if drone.program is not None:
                send_signal(drone.program, signal.SIGTERM)
                self._later(kill_after(drone.program, PROGRAM_END_S))

    def died(self, name: str) -> str:
        """Returns the last words of a drone's program that died."""
        return last_words(self._orders.out / f"{name}.stderr.txt")

    # --- processes ---

    async def spawn(self, command: Command, name: str, shares: str = "") -> Child:
        child = await spawn(command, self._orders.out / f"{name}.stderr.txt", shares)
        self.children.append(child)
        return child

    async def _listen(self, drone: LiveDrone, program: Child) -> None:
        """Passes on what a program says until it has ended."""
        assert program.stdout is not None
        async for line in program.stdout:
            if not line.endswith(b"\n"):
                continue  # it was killed in the middle of it
            if line.startswith(RECORD):
                write(self.world, line)
                continue
            event = decode_event(line)
            if isinstance(event, RoleResult):
                drone.result = event
            elif isinstance(event, Progress):
                self._reported(drone.name)
                self._orders.emit(event)
                self.legs.on_progress(drone.name, event)
            else:
                self._hear(drone.name, line)
        await program.wait()

    def _reported(self, name: str) -> None:
        """Its parts are open; with the last that is awaited the time of what is on the ground begins."""
        if name in self._awaited:
            self._awaited.discard(name)
            if not self._awaited:
                self.tell_world({"begin": True})

    def _hear(self, name: str, line: bytes) -> None:
        with contextlib.suppress(ValueError):  # a library's own output
            word = json.loads(line)
            if isinstance(word, dict):
                self._orders.heard(name, word)

    async def _tell_news(self) -> None:
        while True:
            for drone in self.drones.values():
                if drone.program is not None and drone.program.returncode is None:
                    news = self._orders.news(drone.name)
                    if news != drone.told:
                        drone.told = news
                        write(drone.program, json.dumps(news).encode() + b"\n")
            await asyncio.sleep(NEWS_S)

    async def _watch_records(self) -> None:
        """Watches what a drone writes down for a restart, as soon as it is there, while a fault waits for it."""
        seen: dict[str, str] = {}
        while True:
            waited_for = [name for name in self.drones if self.legs.waits_for_duty(name)]
            for name in waited_for:
                duty = duty_of(self._orders.out / f"{name}.state.json")
                if duty != seen.get(name):
                    seen[name] = duty
                    self.legs.on_duty(name, duty)
            await asyncio.sleep(RECORD_POLL_S if waited_for else NEWS_S)

    async def _watch_world(self) -> None:
        while True:
            event = await read_world(self.world)
            if "event" in event:
                self.said[event["event"]] = event

    def _later(self, what: Coroutine[Any, Any, Any] | Awaitable[Any]) -> None:
        task = asyncio.ensure_future(what)
        self._coming.add(task)
        task.add_done_callback(self._coming.discard)

    # --- faults ---

    def _inject(self, leg: int, fault: Fault) -> None:
        """A fault at the drone that has, or had, its role in the leg; the world is told when it began."""
        role, at_ns = fault.kind.role, time.monotonic_ns()
        name = None if role is None else self.legs.end_of(leg, role)
        if name is not None:
            self._hit(self.drones[name], fault)
        elif fault.name == "attack":
            self._later(self.spawn(self._orders.attack(fault.value or 0.0, self.said["ready"]), "attack"))
        ends = [self.legs.end_of(leg, each) for each in (Role.SENDER, Role.RECEIVER)]
        self.tell_world(
            {"fault": fault.name, "leg": leg, "ends": ends, "drone": name, "value": fault.value, "at_ns": at_ns}
        )

    def _hit(self, drone: LiveDrone, fault: Fault) -> None:
        program = drone.program
        if program is not None and program.returncode is None:
            if fault.kills is not None:
                drone.killed, drone.restart_s = True, None if self.stop.is_set() else fault.value
                program.kill()
            elif fault.stops is not None:
                send_signal(program, signal.SIGSTOP)
                self._later(go_on(program, fault.value))
        if fault.name == "guard_death" and drone.guard is not None:
            send_signal(drone.guard, signal.SIGKILL)


def _children_s() -> float:
    """Returns the processor time of the processes that have ended."""
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    return spent.ru_utime + spent.ru_stime
