"""The drones' programs and guards as processes, in real time: begun, killed, started again,
listened to, by name.

In virtual time ``hil.harness.programs`` does the same with programs that are tasks.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import signal
import time
from collections.abc import Awaitable, Coroutine, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from flight.harness.flights import ABSENT, Progress, RoleResult, decode_event
from hil.harness.leg_faults import LegFaults
from hil.harness.realtime.children import (
    Child,
    drain,
    duty_of,
    end,
    end_gently,
    go_on,
    kill_after,
    last_words,
    send_signal,
    spawn,
    write,
)
from hil.harness.realtime.orders import Command, Orders
from hil.world.faults import Fault
from path.messages import Role

NEWS_S = 0.05
RECORD_POLL_S = 0.001
PROGRAM_END_S = 90.0  # from being told to stop until it has landed
RECORD = b'{"event":"record"'
"""The beginning of a line that the world's monitors are to judge."""


@dataclass(slots=True)
class LiveDrone:
    """One drone's processes.

    Attributes:
        guard_ends: the end of the guard of the flight before.
        killed, restart_s: by a fault; and after how long its program is started again.
        begins: its program is being started; ``due``: faults that strike once it has begun, with
            their legs.
        told: the news that its program knows.
        result: what its newest program said in the end; None: it died, or still flies.
    """

    name: str
    program: Child | None = None
    guard: Child | None = None
    guard_ends: asyncio.Future[None] | None = None
    killed: bool = False
    restart_s: float | None = None
    begins: bool = False
    due: list[tuple[int, Fault]] = field(default_factory=list[tuple[int, Fault]])
    told: Mapping[str, Any] = field(default_factory=dict[str, Any])
    result: RoleResult | None = None

    @property
    def runs(self) -> bool:
        """Whether its program has begun, as far as is known here, and has not ended."""
        return self.program is not None and self.program.returncode is None


class LivePrograms:
    """One program a drone at most, and its guard. They share the world's process, which is told
    what becomes of them.

    Args:
        faults: by the number of their leg; of 0 those of all legs.

    Attributes:
        stop: tells the mission to land everybody; ``interrupted``: whether it was told.
        said: the newest event of each kind that the world said.
        missed: the faults that had nothing to strike, and why, for the report.
    """

    def __init__(
        self, orders: Orders, names: Sequence[str], faults: Mapping[int, Sequence[Fault]]
    ) -> None:
        self._orders = orders
        self.drones = {name: LiveDrone(name) for name in names}
        self.legs = LegFaults(faults, self._inject)
        self.stop = asyncio.Event()
        self.interrupted = False
        self.said: dict[str, dict[str, Any]] = {}
        self.missed: list[str] = []
        self.children: list[Child] = []
        self.world: Child
        self._awaited = set(orders.awaited)
        self._beginning: set[asyncio.Task[Any]] = set()
        self._coming: set[asyncio.Task[Any]] = set()

    async def fly(self, name: str) -> RoleResult | None:
        """A drone's program to its end; killed by a fault it is started again, when the fault says
        so.

        Returns what it said in the end; None when it died.
        """
        drone = self.drones[name]
        while True:
            drone.killed = False
            drone.told = {}
            drone.restart_s = None
            drone.result = None
            await self._begin(drone)
            assert drone.program is not None
            await self._listen(drone, drone.program)
            if drone.result is not None or drone.restart_s is None:
                return drone.result
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self.stop.wait(), drone.restart_s)
            if self.stop.is_set():
                return None

    async def _begin(self, drone: LiveDrone) -> None:
        """Start its program; what was to happen to it meanwhile happens now."""
        name = drone.name
        drone.begins = True
        try:
            drone.program = await self.spawn(
                self._orders.program(name), name, self._orders.shares(name)
            )
        finally:
            drone.begins = False
        self._orders.begun(name, drone.program.pid)
        if self.stop.is_set():
            self._end_gently(drone.program)
        due = drone.due
        drone.due = []
        for leg, fault in due:
            self._inject(leg, fault)

    async def start_guard(self, name: str) -> None:
        """Beside the programs of one flight, in a rig with guards; that of the flight before has
        ended by then.
        """
        drone = self.drones[name]
        command = self._orders.guard(name)
        if drone.guard_ends is not None:
            await drone.guard_ends
        if command is not None and drone.guard is None:
            drone.guard = await self.spawn(command, f"{name}.guard", self._orders.shares(name))
            self._later(drain(drone.guard))

    def end_guard(self, name: str) -> None:
        drone = self.drones[name]
        if drone.guard is not None:
            drone.guard_ends = asyncio.ensure_future(end_gently(drone.guard))
            drone.guard = None

    def interrupt(self) -> None:
        """Gently: they land."""
        self.interrupted = True
        self.stop.set()
        for drone in self.drones.values():
            drone.restart_s = None
            if drone.program is not None:
                self._end_gently(drone.program)

    def _end_gently(self, program: Child) -> None:
        """It lands, and is ended when that takes far too long."""
        send_signal(program, signal.SIGTERM)
        self._later(kill_after(program, PROGRAM_END_S))

    def died(self, name: str) -> str:
        """Return the last words of a drone's program that died."""
        return last_words(self._orders.out / f"{name}.stderr.txt")

    async def close(self) -> None:
        begun = [*self._coming, *self._beginning]
        for task in begun:
            # twice would not let it end the process that it has just started
            if not task.cancelling():
                task.cancel()
        await asyncio.gather(*begun, return_exceptions=True)
        for drone in self.drones.values():
            for _, fault in drone.due:
                self._miss(fault, f"the {drone.name}'s program was not started any more")
        await end(self.children)

    # --- what is heard and told ---

    async def spawn(self, command: Command, name: str, shares: str = "") -> Child:
        """Start a process; the run is not over before whoever is at it."""
        task = asyncio.current_task()
        assert task is not None
        self._beginning.add(task)
        try:
            child = await spawn(command, self._orders.out / f"{name}.stderr.txt", shares)
        finally:
            self._beginning.discard(task)
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
                self._orders.emit(event)
                if event.phase != ABSENT:
                    self._reported(drone.name)
                    self.legs.on_progress(drone.name, event)
            else:
                self._hear(drone.name, line)
        await program.wait()

    def _reported(self, name: str) -> None:
        """Its parts are open; with the last that is awaited the time of what is on the ground
        begins.
        """
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
        """Watch what a drone's program writes down for a restart, as soon as it is there, while a
        fault waits for it.

        Nothing is looked at before that program can be told from outside: a fault then would miss
        it.
        """
        seen: dict[str, str] = {}
        while True:
            waited_for = [name for name in self.drones if self.legs.waits_for_duty(name)]
            for name in waited_for:
                if not self.drones[name].runs:
                    continue
                duty = duty_of(self._orders.out / f"{name}.state.json")
                if duty != seen.get(name):
                    seen[name] = duty
                    self.legs.on_duty(name, duty)
            await asyncio.sleep(RECORD_POLL_S if waited_for else NEWS_S)

    def tell_world(self, command: Mapping[str, Any]) -> None:
        write(self.world, json.dumps(command).encode() + b"\n")

    def _later(self, what: Coroutine[Any, Any, Any] | Awaitable[Any]) -> None:
        task = asyncio.ensure_future(what)
        self._coming.add(task)
        task.add_done_callback(self._coming.discard)

    # --- faults ---

    def _inject(self, leg: int, fault: Fault) -> None:
        """A fault at the drone that has, or had, its role in the leg; the world is told when it
        began.
        """
        role = fault.kind.role
        at_ns = time.monotonic_ns()
        name = None if role is None else self.legs.end_of(leg, role)
        if name is not None and not self._hit(leg, self.drones[name], fault):
            return
        if fault.name == "attack":
            self._later(
                self.spawn(self._orders.attack(fault.value or 0.0, self.said["ready"]), "attack")
            )
        ends = [self.legs.end_of(leg, each) for each in (Role.SENDER, Role.RECEIVER)]
        self.tell_world(
            {
                "fault": fault.name,
                "leg": leg,
                "ends": ends,
                "drone": name,
                "value": fault.value,
                "at_ns": at_ns,
            }
        )

    def _hit(self, leg: int, drone: LiveDrone, fault: Fault) -> bool:
        """False for a fault of a program or guard that is not there: it waits until it is, or is
        missed.
        """
        at_guard = fault.name == "guard_death"
        if not at_guard and fault.kills is None and fault.stops is None:
            return True
        struck = drone.guard if at_guard else drone.program
        if drone.begins and not at_guard:
            drone.due.append((leg, fault))
            return False
        if struck is None or struck.returncode is not None:
            self._miss(
                fault,
                f"the {drone.name} has no guard"
                if at_guard
                else f"the {drone.name}'s program had ended",
            )
            return False
        if fault.stops is not None:
            send_signal(struck, signal.SIGSTOP)
            self._later(go_on(struck, fault.value))
            return True
        if not at_guard:
            drone.killed, drone.restart_s = True, None if self.stop.is_set() else fault.value
        struck.kill()
        return True

    def _miss(self, fault: Fault, why: str) -> None:
        self.missed.append(f"fault {fault.name} had nothing to strike: {why}")
