"""The harness of a relay in real time: the world and every drone's program, and its guard, as processes.

This process is the base, and the field as far as the base can act on it: it starts the others, passes on what they say,
switches faults and makes sure that nothing is left behind.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import signal
import sys
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import msgspec

from drivers.log.mcap_log import parts, read_log
from drivers.rig.check import check_rig
from drivers.rig.parts import Rig, RoleRig
from drivers.rig.tables import RigError
from drivers.stop_signals import leave_signals, stop_on_signals
from flight.harness.flights import Progress, RoleResult, decode_event
from flight.harness.relay import (
    DroneProgram,
    FieldSample,
    FlightTruth,
    RelayConfig,
    RelayReport,
    RelayRequest,
    TargetWatch,
    pair_of,
)
from flight.outcome import Outcome
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
from hil.harness.pace import late_program
from hil.harness.preparation import starting
from hil.harness.relay_live import run_of
from hil.world.errors import level_of, reported
from hil.world.faults import Fault, FaultError, parse_faults
from path.messages import Role

LANDING_LIMIT_S = 60.0
BEYOND_S = 240.0  # besides its hours: the last leg, the way home, and landing
NEWS_S = 0.05
RECORD_POLL_S = 0.001
PROGRAM_END_S = 90.0  # from being told to stop until it has landed
RECORD = b'{"event":"record"'


class RelaySitl:
    """Flies a relay of level ``sitl``."""

    def fly(self, request: RelayRequest) -> RelayReport:
        """Raises PartError for a rig whose drones are not told apart, and for faults that there are not."""
        check_drones(request.rig, request.config)
        faults = {leg: [_parse(text, request.rig.level) for text in texts] for leg, texts in request.faults.items()}
        return asyncio.run(_ProcessRelay(request, faults).run())


def check_drones(rig: Rig, config: RelayConfig) -> None:
    """Raises RigError when two drones are the same on the wire."""
    for drone in config.drones:
        if drone.vehicle is None or drone.link is None or (rig.sender.guard is not None and drone.guard is None):
            what = f"{drone.name} needs a vehicle, a link, and in a rig with guards a guard, of its own in real time"
            raise RigError([rig.where(f"[relay] drones: {what}")])
    for one, other in combinations(config.drones, 2):
        check_rig(pair_of(rig, one, other))


def _parse(text: str, level: str) -> Fault:
    (fault,) = parse_faults([text], level)
    if fault.name == "attack":
        raise FaultError("fault attack needs a pair with a key", "fly it with handoff, on a rig of level sitl")
    return fault


@dataclass(slots=True)
class _DroneProcesses:
    """One drone's processes. ``told``: the news that its program knows; ``guard_ends``: that of the flight before."""

    name: str
    own: RoleRig
    program: Child | None = None
    guard: Child | None = None
    guard_ends: asyncio.Future[None] | None = None
    killed: bool = False
    restart_s: float | None = None
    told: Mapping[str, Any] | None = None


class _ProcessRelay:
    """One relay in real time: the ``flight.harness.relay.RelayField``."""

    def __init__(self, request: RelayRequest, faults: Mapping[int, list[Fault]]) -> None:
        self._request, self._out = request, request.out
        self._legs = LegFaults(faults, self._inject)
        self._stop = asyncio.Event()
        self._interrupted = False
        self._landed: Mapping[str, bool] = {}
        self._log_failure = ""
        self._children: list[Child] = []
        self._coming: set[asyncio.Task[None]] = set()
        self._drones = {
            drone.name: _DroneProcesses(drone.name, pair_of(request.rig, drone, drone).receiver)
            for drone in request.config.drones
        }

    async def run(self) -> RelayReport:
        failure = slow = ""
        start_s = time.monotonic()
        finished: Mapping[str, Any] = {}
        try:
            self._world = await self._start_world()
            await self._fly()
            finished = await finish_world(self._world, LANDING_LIMIT_S)
        except WorldTooSlow as error:
            failure = slow = str(error)
        except HarnessFailure as error:
            failure = str(error)
        finally:
            for task in self._coming:
                task.cancel()
            await end(self._children)
        return self._report(finished, failure, slow, time.monotonic() - start_s)

    async def _start_world(self) -> Child:
        request, rig = self._request, self._request.rig
        arguments = [str(rig.file), str(len(request.config.drones)), str(request.seed), level_of(rig)]
        command = [sys.executable, "-m", "hil.harness.relay_sitl_world", *arguments, *map(str, rig.folders)]
        world = await spawn(command, self._out / "world.stderr.txt")
        self._children.append(world)
        await until_ready(world, lambda what: request.emit(starting(Role.SENDER, what)))
        return world

    async def _fly(self) -> None:
        """Flies until the base says that it is over, the world fails, or it takes far too long."""
        request = self._request
        self._landed = dict.fromkeys(self._drones, True)
        stop_on_signals(self._interrupt)
        watcher = asyncio.create_task(self._watch_world())
        news = asyncio.create_task(self._tell_news())
        records = asyncio.create_task(self._watch_records())
        main = asyncio.ensure_future(request.main(self, self._stop, request.emit))
        limit_s = 3600.0 * request.hours + BEYOND_S
        try:
            tasks = (watcher, news, records, main)
            done, _ = await asyncio.wait(tasks, timeout=limit_s, return_when=asyncio.FIRST_COMPLETED)
            if not done:
                raise HarnessFailure(f"the relay did not end within {limit_s:.0f} s")
            for task in done:
                task.result()
        finally:
            self._legs.close()
            for task in (watcher, news, records, main):
                task.cancel()
            await asyncio.gather(watcher, news, records, main, return_exceptions=True)
            leave_signals()

    # --- the field ---

    async def begin(self, name: str, program: DroneProgram) -> RoleResult | None:
        """Its program is a process, and knows what to fly: ``program`` is for others."""
        del program
        drone, processes = self._drones[name], self._request.processes
        self._tell_world({"on": name})
        if drone.guard_ends is not None:
            await drone.guard_ends
        if drone.own.guard is not None and drone.guard is None:
            drone.guard = await self._spawn(name, processes.guard_command(name), f"{name}.guard.stderr.txt")
            self._later(drain(drone.guard))
        while True:
            drone.killed, drone.told, drone.restart_s = False, None, None
            drone.program = await self._spawn(name, processes.command(name), f"{name}.stderr.txt")
            if self._stop.is_set():
                send_signal(drone.program, signal.SIGTERM)
            result = await self._listen(drone, drone.program)
            if result is None:
                self._tell_world({"died": name, "at_ns": time.monotonic_ns()})
            if result is not None or drone.restart_s is None or self._stop.is_set():
                break
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._stop.wait(), drone.restart_s)
            if self._stop.is_set():
                break
        self._tell_world({"camera_off": name})
        if result is None and not drone.killed:
            what = f"its program died. {last_words(self._out / f'{name}.stderr.txt')}"
            return RoleResult(Role.RECEIVER, Outcome.CRASHED, what, responsible=False, landed=False)
        return result

    def open_leg(self, number: int, sender: str, receiver: str) -> None:
        self._tell_world({"leg": number, "sender": sender, "receiver": receiver})
        self._legs.open_leg(number, sender, receiver)

    def landed(self, name: str) -> bool:
        return self._landed[name]

    def swap(self, name: str) -> None:
        drone = self._drones[name]
        if drone.guard is not None:
            drone.guard_ends = asyncio.ensure_future(end_gently(drone.guard))
            drone.guard = None
        self._tell_world({"off": name})

    # --- processes ---

    async def _spawn(self, name: str, command: Any, errors: str) -> Child:
        child = await spawn(command, self._out / errors, run_of(run_name(), name))
        self._children.append(child)
        return child

    async def _listen(self, drone: _DroneProcesses, program: Child) -> RoleResult | None:
        """Passes on what a program says until it has ended. Returns None when it died."""
        assert program.stdout is not None
        result: RoleResult | None = None
        async for line in program.stdout:
            if not line.endswith(b"\n"):
                continue  # it was killed in the middle of it
            if line.startswith(RECORD):
                write(self._world, line)
                continue
            event = decode_event(line)
            if isinstance(event, RoleResult):
                result = event
                self._log_failure = self._log_failure or event.log_failure
            elif isinstance(event, Progress):
                self._request.emit(event)
                self._legs.on_progress(drone.name, event)
            else:
                self._hear(drone.name, line)
        await program.wait()
        return result

    def _hear(self, name: str, line: bytes) -> None:
        try:
            word = json.loads(line)
        except ValueError:
            return  # a library's own output
        if isinstance(word, dict):
            self._request.processes.heard(name, word)

    async def _tell_news(self) -> None:
        """Tells every program whatever it does not know yet."""
        while True:
            for drone in self._drones.values():
                program = drone.program
                if program is None or program.returncode is not None:
                    continue
                news = self._request.processes.news(drone.name)
                if news != drone.told:
                    drone.told = news
                    write(program, json.dumps(news).encode() + b"\n")
            await asyncio.sleep(NEWS_S)

    async def _watch_records(self) -> None:
        """Watches what a drone writes down for a restart, as soon as it is there, while a fault waits for it."""
        seen: dict[str, str] = {}
        while True:
            waited_for = [name for name in self._drones if self._legs.waits_for_duty(name)]
            for name in waited_for:
                duty = duty_of(self._out / f"{name}.state.json")
                if duty != seen.get(name):
                    seen[name] = duty
                    self._legs.on_duty(name, duty)
            await asyncio.sleep(RECORD_POLL_S if waited_for else NEWS_S)

    async def _watch_world(self) -> None:
        while True:
            event = await read_world(self._world)
            if event.get("event") == "landed":
                self._landed = event["landed"]

    def _tell_world(self, command: Mapping[str, Any]) -> None:
        write(self._world, json.dumps(command).encode() + b"\n")

    def _interrupt(self) -> None:
        """Gently: they land."""
        self._interrupted = True
        self._stop.set()
        for drone in self._drones.values():
            drone.restart_s = None
            if drone.program is not None:
                send_signal(drone.program, signal.SIGTERM)
                self._later(kill_after(drone.program, PROGRAM_END_S))

    def _later(self, what: Any) -> None:
        task = asyncio.ensure_future(what)
        self._coming.add(task)
        task.add_done_callback(self._coming.discard)

    # --- faults ---

    def _inject(self, leg: int, fault: Fault) -> None:
        """Injects a fault at the drone that has, or had, its role in the leg."""
        role = fault.kind.role
        name = None if role is None else self._legs.end_of(leg, role)
        at_ns = time.monotonic_ns()
        if name is not None:
            self._hit(self._drones[name], fault)
        told = {"fault": fault.name, "leg": leg, "drone": name, "value": fault.value, "at_ns": at_ns}
        self._tell_world(told)

    def _hit(self, drone: _DroneProcesses, fault: Fault) -> None:
        program = drone.program
        if program is not None and program.returncode is None:
            if fault.kills is not None:
                drone.killed, drone.restart_s = True, None if self._stop.is_set() else fault.value
                program.kill()
            elif fault.stops is not None:
                send_signal(program, signal.SIGSTOP)
                self._later(go_on(program, fault.value))
        if fault.name == "guard_death" and drone.guard is not None:
            send_signal(drone.guard, signal.SIGKILL)

    # --- the end ---

    def _report(self, finished: Mapping[str, Any], failure: str, slow: str, wall_s: float) -> RelayReport:
        if not failure and not finished:
            failure = "the world gave no findings"
        aloft = finished.get("aloft", ())
        closest_m = finished.get("closest_m", None)
        return RelayReport(
            violations=finished.get("violations", {}),
            notes=tuple(finished.get("notes", ())),
            gaps_s={int(leg): gap_s for leg, gap_s in finished.get("gaps_s", {}).items()},
            flown=msgspec.convert(finished.get("flown", []), list[FlightTruth]),
            samples=msgspec.convert(finished.get("samples", []), list[FieldSample]),
            closest_m=float("nan") if closest_m is None else closest_m,
            closest_pair=tuple(finished.get("closest_pair", ())),
            simulated_s=finished.get("simulated_s", wall_s),
            wall_s=wall_s,
            watched=msgspec.convert(finished.get("watched", []), list[TargetWatch]),
            bytes_sent=finished.get("bytes_sent", {}),
            aloft_s=finished.get("aloft_s", {}),
            interrupted=self._interrupted,
            log_failure=self._log_failure,
            errors=reported(self._request.rig),
            overload=slow or "; ".join(late_programs(self._out, self._drones)),
            failure=failure or (f"not landed at the end: {', '.join(aloft)}" if aloft else ""),
        )


def late_programs(out: Path, drones: Iterable[str]) -> list[str]:
    """Returns which drones' programs took up their frames too late, and how late, by their logs."""
    late: list[str] = []
    for name in drones:
        ages_s = [
            float(record.record["age_ns"]) * 1e-9
            for part in parts(out, name)
            for record in read_log(part)
            if record.topic == "/frame"
        ]
        late += late_program(f"{name}'s program", ages_s)
    return late
