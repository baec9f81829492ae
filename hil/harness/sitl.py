"""The ``sitl`` harness: the world and both roles as processes, in real time, with real sockets between them.

This process only starts them, passes on what they say, switches faults and makes sure that nothing is left behind.
"""

from __future__ import annotations

import asyncio
import signal
import sys
import time
from collections.abc import Awaitable, Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from drivers.cpu_share import CpuShare
from drivers.log.mcap_log import LogRecord, parts, read_log
from drivers.rig.parts import Rig
from drivers.rig.tables import decode_table
from drivers.stop_signals import leave_signals, stop_on_signals
from flight.harness.flights import FlightReport, FlightRequest, Progress, RoleResult, decode_event
from hil.harness.children import (
    Child,
    HarnessFailure,
    WorldTooSlow,
    duty_of,
    end,
    finish_world,
    go_on,
    last_words,
    read_world,
    send_signal,
    spawn,
    tell,
    until_ready,
)
from hil.harness.pace import overload_of
from hil.harness.preparation import prepare, starting
from hil.harness.sim import mission_config
from hil.monitors.monitors import Monitors
from hil.vehicle.simulator_process import binary_of
from hil.world.check import check_world
from hil.world.errors import level_of, reported
from hil.world.faults import Fault, FaultError, FaultTrigger, parse_faults
from hil.world.world import WorldConfig
from path.messages import Role

RUN_LIMIT_S = 360.0  # besides what the mission allows for verifying and following
LANDING_LIMIT_S = 45.0
ROLE_EXIT_S = 60.0
RECORD_POLL_S = 0.001

StartRole = Callable[[Role], Awaitable[Child]]
StartAttack = Callable[[float], Awaitable[Child]]


@dataclass(slots=True)
class _Run:
    """The state of a run while it goes on."""

    request: FlightRequest
    results: dict[Role, RoleResult] = field(default_factory=dict[Role, RoleResult])
    interrupted: bool = False
    finished: dict[str, Any] | None = None
    slow: str = ""

    @property
    def limit_s(self) -> float:
        mission = mission_config(self.request.rig)
        return RUN_LIMIT_S + mission.deadlines.verify_s + mission.follow_after_s


class SitlHarness:
    """Real MAVSDK, real sockets, rendered frames through pyrealsense2; vehicles embedded, or real autopilots."""

    check_rig = staticmethod(check_world)
    prepare = staticmethod(prepare)

    def fly(self, request: FlightRequest) -> FlightReport:
        """Raises PartError when the rig needs an autopilot that was not named, or a share of a core it cannot have."""
        config = decode_table(request.rig.world, WorldConfig, request.rig.where("[world]"))
        for role in Role:
            simulator = config.simulator(role)
            if simulator is not None and simulator.to_start:
                binary_of(simulator.kind)
            if simulator is not None and simulator.on_board and "fc_link_loss" in " ".join(request.faults):
                raise FaultError("fault fc_link_loss: the harness has no hold of the board's cable", "pull it yourself")
        with ExitStack() as stack:
            shares: dict[Role, CpuShare] = {}
            if config.slow is not None:
                shares = {role: stack.enter_context(CpuShare(role.value, config.slow)) for role in Role}
            report = asyncio.run(_fly(request, shares))
            slow = {} if config.slow is None else {"share": config.slow}
            stopped = {f"{role.value}_stopped_s": round(share.stopped_s(), 3) for role, share in shares.items()}
            return replace(report, slow={**slow, **stopped})


async def _fly(request: FlightRequest, shares: Mapping[Role, CpuShare]) -> FlightReport:
    faults = parse_faults(request.faults, request.rig.level)
    if any(fault.name == "attack" for fault in faults):
        _need_keys(request.rig)
    run = _Run(request)
    start_s = time.monotonic()
    processes: list[Child] = []
    failure = ""
    try:
        world, air = await _start_world(request, processes)
        crew = _Crew(
            world,
            lambda role: _start_role(request, role, processes, shares.get(role)),
            lambda rate: _start_attack(request, rate, air, processes),
        )
        for role in Role:
            if request.rig.role(role).guard is not None:
                crew.guards[role] = await _start_guard(request, role, processes)
        await _supervise(run, FaultTrigger(faults), crew)
        run.finished = await finish_world(world, LANDING_LIMIT_S)
    except WorldTooSlow as error:
        failure = run.slow = str(error)
    except HarnessFailure as error:
        failure = str(error)
    finally:
        await end(processes)
    return _report(run, failure, time.monotonic() - start_s)


def _need_keys(rig: Rig) -> None:
    """Raises FaultError when the drones would believe anybody."""
    for role in Role:
        if "key_file" not in rig.role(role).link.options:
            raise FaultError(
                f"fault attack: {rig.where(f'{role.value}.link')} has no key_file, so that any packet is believed",
                "copy the rig, make a key (head -c 32 /dev/urandom > pair.key && chmod 600 pair.key), and name it "
                "there for both drones",
            )


async def _start_world(request: FlightRequest, processes: list[Child]) -> tuple[Child, int]:
    """Its process, and the port on which it lets others on the air."""
    rig = request.rig
    arguments = [str(rig.file), str(request.out), str(request.seed), level_of(rig), *map(str, rig.folders)]
    world = await spawn([sys.executable, "-m", "hil.harness.sitl_world", *arguments], request.out / "world.stderr.txt")
    processes.append(world)

    def warming(what: str) -> None:
        for role in Role:
            request.emit(starting(role, what))

    ready = await until_ready(world, warming)
    return world, int(ready.get("air", 0))


async def _start_attack(request: FlightRequest, rate: float, air: int, processes: list[Child]) -> Child:
    """The third process: it knows where both drones listen, and hears and sends on the air."""
    ends = [str(request.rig.role(role).link.options["bind"]) for role in (Role.SENDER, Role.RECEIVER)]
    arguments = [f"{rate:g}", str(air), *ends, str(request.seed), str(request.out)]
    process = await spawn([*request.attack_command, *arguments], request.out / "attack.stderr.txt")
    processes.append(process)
    return process


async def _start_role(
    request: FlightRequest, role: Role, processes: list[Child], share: CpuShare | None = None
) -> Child:
    process = await spawn(request.role_command(role), request.out / f"{role.value}.stderr.txt")
    if share is not None:
        share.add(process.pid)
    processes.append(process)
    return process


async def _start_guard(request: FlightRequest, role: Role, processes: list[Child]) -> Child:
    assert request.guard_command is not None  # of a rig with guards
    process = await spawn(request.guard_command(role), request.out / f"{role.value}.guard.stderr.txt")
    processes.append(process)
    return process


class _Crew:
    """The world's process and those of the roles, which may die and be started again."""

    def __init__(self, world: Child, start: StartRole, attack: StartAttack) -> None:
        self.world = world
        self._attack = attack
        self.guards: dict[Role, Child] = {}
        self.roles: dict[Role, Child] = {}
        self._start = start
        self._restart_s: dict[Role, float] = {}
        self._waited_for = set(Role)
        self._coming: set[asyncio.Task[None]] = set()

    async def start(self, role: Role) -> None:
        self.roles[role] = await self._start(role)

    async def reports(self, role: Role) -> None:
        """Its program's parts are open; with the last of both the time of what is on the ground begins."""
        if role in self._waited_for:
            self._waited_for.discard(role)
            if not self._waited_for:
                await tell(self.world, {"begin": True})

    def begin(self, faults: Sequence[Fault]) -> None:
        for fault in faults:
            task = asyncio.ensure_future(self._inject(fault))
            self._coming.add(task)
            task.add_done_callback(self._coming.discard)

    async def _inject(self, fault: Fault) -> None:
        if fault.after_s:
            await asyncio.sleep(fault.after_s)
        at_ns = time.monotonic_ns()
        if fault.kills is not None:
            process = self.roles[fault.kills]
            if process.returncode is None:
                process.kill()
                if fault.value is not None:
                    self._restart_s[fault.kills] = fault.value
        elif fault.name == "attack":
            await self._attack(fault.value or 0.0)
        elif fault.stops is not None:
            send_signal(self.roles[fault.stops], signal.SIGSTOP)
        elif fault.name == "guard_death" and Role.SENDER in self.guards:
            send_signal(self.guards[Role.SENDER], signal.SIGKILL)
        await tell(self.world, {"fault": fault.name, "value": fault.value or 0.0, "at_ns": at_ns})
        if fault.stops is not None:
            await go_on(self.roles[fault.stops], fault.value)

    async def started_again(self, role: Role) -> bool:
        """Returns whether another program was started once a role's has ended, as the fault that killed it wants."""
        after_s = self._restart_s.pop(role, None)
        if after_s is None:
            return False
        await asyncio.sleep(after_s)
        await self.start(role)
        return True

    def stop(self) -> None:
        """Gently: they land."""
        self._restart_s.clear()
        for process in self.roles.values():
            if process.returncode is None:
                process.send_signal(signal.SIGTERM)

    async def close(self) -> None:
        for task in self._coming:
            task.cancel()
        await asyncio.gather(*self._coming, return_exceptions=True)


async def _supervise(run: _Run, trigger: FaultTrigger, crew: _Crew) -> None:
    """Passes on the events of both role programs until they have ended.

    Switches faults, and stops them when told to.
    """

    def stop() -> None:
        run.interrupted = True
        crew.stop()

    async def listen(role: Role) -> None:
        while True:
            process = crew.roles[role]
            assert process.stdout is not None
            async for line in process.stdout:
                event = decode_event(line)
                if isinstance(event, RoleResult):
                    run.results[role] = event
                elif isinstance(event, Progress):
                    await crew.reports(role)
                    run.request.emit(event)
                    crew.begin(trigger.on_progress(event))
            await process.wait()
            if run.interrupted or not await crew.started_again(role):
                return

    async def watch_record(role: Role) -> None:
        """Watches what a role writes down for a restart, as soon as it is there."""
        file, seen = run.request.out / f"{role.value}.state.json", ""
        while trigger.waits_for_duty(role):
            duty = duty_of(file)
            if duty != seen:
                seen = duty
                crew.begin(trigger.on_duty(role, duty))
            await asyncio.sleep(RECORD_POLL_S)

    async def watch_world() -> None:
        while True:
            await read_world(crew.world)

    stop_on_signals(stop)
    crew.begin(trigger.from_the_start())
    for role in Role:
        await crew.start(role)
    watcher = asyncio.create_task(watch_world())
    readers = [asyncio.create_task(watch_record(role)) for role in Role]
    listeners = asyncio.gather(*(listen(role) for role in Role))
    try:
        done, _ = await asyncio.wait([watcher, listeners], timeout=run.limit_s, return_when=asyncio.FIRST_COMPLETED)
        if not done:
            stop()
            await asyncio.wait([listeners], timeout=ROLE_EXIT_S)
            raise HarnessFailure(f"the run did not end within {run.limit_s:.0f} s")
        for task in done:
            task.result()
    finally:
        beside = asyncio.gather(watcher, *readers)
        for tasks in (beside, listeners):
            tasks.cancel()
        await asyncio.gather(beside, listeners, return_exceptions=True)
        await crew.close()
        leave_signals()


def _died(out: Path, role: Role) -> str:
    return f"the {role.value}'s program died. {last_words(out / f'{role.value}.stderr.txt')}"


def _records(out: Path) -> Iterator[tuple[int, Role, LogRecord | None]]:
    """Yields both roles' log records, of all their programs.

    None where the log of one ends without an outcome: it died.
    """
    for role in Role:
        for part in parts(out, role.value):
            newest_ns, ended = 0, False
            for record in read_log(part):
                newest_ns, ended = max(newest_ns, record.stamp_ns), ended or record.topic == "/outcome"
                yield record.stamp_ns, role, record
            if not ended:
                yield newest_ns, role, None


def _report(run: _Run, failure: str, wall_s: float) -> FlightReport:
    request, finished = run.request, run.finished or {}
    monitors = Monitors(request.rig.method, min_separation_m=0.0)
    ages_s: dict[Role, list[float]] = {role: [] for role in Role}
    for stamp_ns, role, record in sorted(_records(request.out), key=lambda entry: entry[0]):
        if record is None:
            monitors.on_death(role)
        else:
            monitors.on_record(role, record.topic, stamp_ns, record.record)
            if record.topic == "/frame":
                ages_s[role].append(float(record.record["age_ns"]) * 1e-9)
    violations = dict(monitors.violations)
    for name, count in finished.get("violations", {}).items():
        violations[name] = violations.get(name, 0) + count
    notes = [*monitors.details, *finished.get("details", [])]
    if not failure and not finished:
        failure = "the world gave no findings"
    dead = [role for role in Role if role not in run.results]
    return FlightReport(
        results={role: run.results.get(role) for role in Role},
        landed={role: bool(finished.get("landed", {}).get(role.value, False)) for role in Role},
        violations=violations,
        simulated_s=wall_s,
        wall_s=wall_s,
        interrupted=run.interrupted,
        failure=failure,
        overload=run.slow or overload_of(ages_s, finished.get("frames", {})),
        notes=[*notes, *(_died(request.out, role) for role in dead)],
        errors=reported(request.rig),
    )
