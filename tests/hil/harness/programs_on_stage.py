"""Small programs in the places of the world and the roles of a run in real time."""

from __future__ import annotations

import asyncio
import json
import sys
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from drivers.cpu_share import CpuShare
from flight.harness.flights import FlightRequest, Progress, RoleResult, encode_event
from flight.outcome import Outcome
from hil.harness import sitl
from hil.harness.realtime import children
from hil.harness.realtime.run import RealTimeRun
from hil.harness.sim import LEG
from hil.world.faults import parse_fault
from path.messages import Role


def result(role: Role, outcome: Outcome = Outcome.COMMITTED) -> RoleResult:
    return RoleResult(role, outcome, "", responsible=False, landed=True)


def progress(role: Role, count: int = 0) -> Progress:
    return Progress(role, 0, "verify", count, 350, None, None, None, 0.0, False, "")


def saying(*lines: object, then: str = "") -> str:
    """A program that prints lines, events as JSON, and does something."""
    texts = [line if isinstance(line, str) else encode_event(line) for line in lines]  # type: ignore[arg-type]
    return "\n".join([*(f"print({text!r}, flush=True)" for text in texts), textwrap.dedent(then)])


READY = 'print(\'{"event": "ready", "air": 1}\', flush=True)\n'
WRITES_DOWN = """
import sys
with open({file!r}, "a") as file:
    for line in sys.stdin:
        file.write(line)
        file.flush()
        if "finish" in line:
            print('{{"event": "finished"}}', flush=True)
"""
Programs = Mapping[Role, str | Sequence[str]]
UNTIL_STDIN_ENDS = "import sys; sys.stdin.read()"


@dataclass
class Stage:
    """A run folder, the programs in it, and what the console was shown."""

    rig: Any
    out: Path
    shown: list[Progress] = field(default_factory=list[Progress])
    processes: list[asyncio.subprocess.Process] = field(
        default_factory=list[asyncio.subprocess.Process]
    )
    on_progress: Any = None
    ending: Any = None
    shares: Mapping[str, CpuShare] = field(default_factory=dict[str, CpuShare])
    awaited: frozenset[str] = frozenset()

    @property
    def request(self) -> FlightRequest:
        no_role: Any = None  # roles are processes here
        return FlightRequest(self.rig, self.out, 1, (), no_role, lambda role: [], self.show)

    def show(self, shown: Progress) -> None:
        self.shown.append(shown)
        if self.on_progress is not None:
            self.on_progress(shown)

    async def start(self, name: str, program: str) -> asyncio.subprocess.Process:
        command: Sequence[str] = [sys.executable, "-I", "-S", "-c", program]
        process = await children.spawn(command, self.out / f"{name}.stderr.txt")
        self.processes.append(process)
        return process

    def run_of(
        self, programs: Programs, faults: Sequence[str] = (), world: str = ""
    ) -> RealTimeRun:
        """``world`` writes down what it is told. A role's programs start one after another."""
        left = {
            role: iter([own] if isinstance(own, str) else own) for role, own in programs.items()
        }

        def python(program: str) -> Sequence[str]:
            return [sys.executable, "-I", "-S", "-c", program]

        def command(name: str) -> Sequence[str]:
            return python(next(left[Role(name)]))

        orders = replace(
            sitl.orders_of(self.request, self.shares),
            world=python(READY + (world or WRITES_DOWN.format(file=str(self.out / "told")))),
            program=command,
            awaited=self.awaited,
        )
        return RealTimeRun(orders, sitl.ENDS, {LEG: [parse_fault(text) for text in faults]})

    def fly(
        self,
        programs: Programs,
        faults: Sequence[str] = (),
        world: str = "",
        limit_s: float = 600.0,
    ) -> RealTimeRun:
        """One run to its end."""
        run = self.run_of(programs, faults, world)
        self.ending = asyncio.run(run.run(lambda: sitl.one_leg(run), limit_s, 0.5))
        self.processes = run.children
        return run

    def told(self) -> list[Any]:
        """Returns the faults that the world was told of: their names, of which drone, their
        values.
        """
        told = [json.loads(line) for line in (self.out / "told").read_text().splitlines()]
        return [
            (command["fault"], command["drone"], command["value"])
            for command in told
            if "fault" in command
        ]


def results(run: RealTimeRun) -> dict[Role, RoleResult]:
    return {
        Role(name): drone.result for name, drone in run.drones.items() if drone.result is not None
    }


def gone(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return True
    return state == "Z"
