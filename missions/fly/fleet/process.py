"""One drone's program, and its guard, as processes of their own: children of ``path-handoff relay``
and ``team``.

    python -m missions.fly.fleet.process program RIG DRONES/TARGETS NAME FOLDER whole|rare
    python -m missions.fly.fleet.process guard   RIG DRONES/TARGETS NAME FOLDER

Of a relay no TARGETS are named. What the base knows comes in on stdin as lines of JSON; what the
drone says, and what the monitors read of its log, goes out on stdout. A closed stdin ends it,
gently.
"""

from __future__ import annotations

import asyncio
import gc
import json
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import msgspec

from drivers.interfaces import Frame, FrameLog, Log
from drivers.log.json_lines import JsonLines
from drivers.log.mcap_log import McapLog, encode_other, new_part
from drivers.log.state_file import StateFile
from drivers.rig.parts import Rig
from drivers.stop_signals import stop_on_signals
from flight.harness.fleet import RelayConfig, TeamConfig, pair_of
from flight.harness.flights import ProgramContext, Progress, RoleResult, encode_event, with_log
from flight.harness.relay import OFTEN, WATCHED, DroneProcesses, DroneProgram
from missions.fly.guard.command import watch_vehicles
from missions.fly.relay.drone.life import DroneFlight
from missions.fly.relay.ground import Ground
from missions.fly.relay.legs import Base
from missions.fly.relay.line import FarBase, hear, news_of
from missions.fly.team.base import TeamBase
from missions.fly.team.flight import TeamFlight
from missions.ground import rig_library
from missions.ground.shown import Said, tell_line
from missions.ground.team_config import relay_of, team_of
from path.messages import Role


def flight_of(
    rig: Rig,
    config: RelayConfig,
    ground: Ground,
) -> DroneProgram:
    """Return the program of any drone of a relay, or of a team."""

    def program(name: str, given: ProgramContext) -> DroneFlight:
        if isinstance(config, TeamConfig):
            return TeamFlight(rig, config, ground, name, given)
        return DroneFlight(rig, config, ground, name, given)

    return program


def processes_of(
    rig: Rig,
    base: Base | TeamBase,
    out: Path,
    whole_log: bool,
) -> DroneProcesses:
    """Return how the harness starts the processes of the drones."""
    config = base.config
    targets = len(config.targets) if isinstance(config, TeamConfig) else ""
    size = f"{len(config.drones)}/{targets}"
    logs = "whole" if whole_log else "rare"

    def command(what: str, name: str, *more: str) -> Sequence[str]:
        own = [what, str(rig.file), size, name, str(out), *more]
        return [sys.executable, "-m", "missions.fly.fleet.process", *own]

    return DroneProcesses(
        command=lambda name: command("program", name, logs),
        guard_command=lambda name: command("guard", name),
        news=lambda name: news_of(base, name),
        heard=lambda name, word: hear(base, name, word),
    )


class RelayedLog:
    """The log of a drone's program, of which the monitors in another process read what they judge
    by.
    """

    def __init__(
        self,
        log: Log,
        name: str,
        whole: bool,
        say: Callable[[str], None] = tell_line,
    ) -> None:
        self._log = log
        self._say = say
        self._name = name
        self._whole = whole
        self._encoder = msgspec.json.Encoder(enc_hook=encode_other)
        self._shown_ns: dict[str, int] = {}

    def write(
        self,
        topic: str,
        stamp_ns: int,
        record: Mapping[str, Any],
    ) -> None:
        if self._whole or topic not in OFTEN:
            self._log.write(topic, stamp_ns, record)
        if stamp_ns - self._shown_ns.get(topic, -(1 << 62)) >= WATCHED.get(topic, math.inf) * 1e9:
            self._shown_ns[topic] = stamp_ns
            shown = self._encoder.encode(
                {"event": "record", "record": [self._name, topic, stamp_ns, record]}
            )
            self._say(shown.decode())

    def image(
        self,
        topic: str,
        stamp_ns: int,
        image: Any,
    ) -> None:
        if self._whole:
            self._log.image(topic, stamp_ns, image)

    def frame(self, frame: Frame) -> None:
        if self._whole and isinstance(self._log, FrameLog):
            self._log.frame(frame)


async def _fly(
    rig: Rig,
    config: RelayConfig,
    name: str,
    log: Log,
    store: StateFile,
    say: Callable[[str], None],
) -> RoleResult:
    """Listen until there is an order, then fly it to its end."""
    base = FarBase(name, lambda word: say(json.dumps(word)))
    stop = asyncio.Event()
    ordered = asyncio.Event()
    loop = asyncio.get_running_loop()
    standard_input = sys.stdin.fileno()
    lines = JsonLines(standard_input)

    def read() -> None:
        news = lines.read()
        if news is None:
            loop.remove_reader(standard_input)
            stop.set()
        for each in news or ():
            base.on_news(each)
        if news is None or base.told:
            ordered.set()

    stop_on_signals(stop.set)
    loop.add_reader(standard_input, read)
    await ordered.wait()
    if not base.told:
        raise SystemExit(f"{name} was never told what for")
    cv2.setNumThreads(1)  # as any role in real time
    gc.freeze()

    def show(progress: Progress) -> None:
        say(encode_event(progress))

    given = ProgramContext(log, show, stop, None, store)
    return await flight_of(rig, config, base)(name, given).run()


def fly(
    rig: Rig,
    config: RelayConfig,
    name: str,
    out: Path,
    whole: bool,
) -> None:
    with McapLog(new_part(out, name), name) as log, Said(sys.stdout) as say:
        store = StateFile(out / f"{name}.state.json", None)
        relayed = RelayedLog(log, name, whole, say)
        result = asyncio.run(_fly(rig, config, name, relayed, store, say))
        lost = f"{say.lost} lines of it found no room on the way to the monitors"
        say(encode_event(with_log(result, log.settled() or (lost if say.lost else None))))


def guard(
    rig: Rig,
    config: RelayConfig,
    name: str,
    out: Path,
) -> int:
    """Watch the drone's vehicle until stdin is closed."""
    drone = next(drone for drone in config.drones if drone.name == name)
    own = pair_of(rig, drone, drone)
    assert own.receiver.guard is not None, f"{name} has no guard"
    logs = {Role.RECEIVER: out / f"{name}.guard.mcap"}
    return asyncio.run(
        watch_vehicles(
            own, rig_library.mission_of(rig), {Role.RECEIVER: own.receiver.guard}, logs,
            until_input_ends=True, while_flown=False,
        )
    )  # fmt: skip


def main() -> None:
    """The program of the process."""
    what, rig_file, size, name, folder, *logs = sys.argv[1:]
    rig = rig_library.load_unchecked(rig_file)
    drones, _, targets = size.partition("/")
    config = team_of(rig, int(drones), int(targets)) if targets else relay_of(rig, int(drones))
    if what == "guard":
        sys.exit(guard(rig, config, name, Path(folder)))
    fly(rig, config, name, Path(folder), logs == ["whole"])


if __name__ == "__main__":
    main()
