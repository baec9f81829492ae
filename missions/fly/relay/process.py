"""One drone's program, and its guard, as processes of their own: children of ``path-handoff relay``
and ``team``.

    python -m missions.fly.relay.process program RIG DRONES NAME FOLDER whole|rare
    python -m missions.fly.relay.process guard   RIG DRONES NAME FOLDER

What the base knows comes in on stdin as lines of JSON; what the drone says, and what the monitors
read of its log, goes out on stdout. A closed stdin ends it, gently.
"""

from __future__ import annotations

import asyncio
import gc
import json
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
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
from flight.harness.fleet import NamedDrone, RelayConfig, pair_of
from flight.harness.flights import ProgramContext, Progress, RoleResult, encode_event, with_log
from flight.harness.relay import OFTEN, WATCHED, DroneProcesses
from missions.fly.guard.command import watch_vehicles
from missions.fly.relay.config import relay_of
from missions.fly.relay.drone.life import DroneFlight
from missions.fly.relay.legs import Base
from missions.fly.relay.line import FarBase, hear, news_of
from missions.ground import rig_library
from missions.ground.shown import Said, tell_line
from path.messages import Role


def processes_of(
    rig: Rig, config: RelayConfig, out: Path, base: Base, whole_log: bool
) -> DroneProcesses:
    """Return how the harness starts the processes of this relay's drones."""
    return DroneProcesses(
        *commands("missions.fly.relay.process", rig, str(len(config.drones)), out, whole_log),
        news=lambda name: news_of(base, name),
        heard=lambda name, word: hear(base, name, word),
    )


def commands(
    module: str, rig: Rig, size: str, out: Path, whole_log: bool
) -> tuple[Callable[[str], Sequence[str]], Callable[[str], Sequence[str]]]:
    """Return the commands of any drone's program, and of its guard. ``size``: how much of the rig
    takes part.
    """

    def command(what: str, name: str, *more: str) -> Sequence[str]:
        return [sys.executable, "-m", module, what, str(rig.file), size, name, str(out), *more]

    logs = "whole" if whole_log else "rare"
    return (lambda name: command("program", name, logs)), (lambda name: command("guard", name))


class RelayedLog:
    """The log of a drone's program, of which the monitors in another process read what they judge
    by.
    """

    def __init__(
        self, log: Log, name: str, whole: bool, say: Callable[[str], None] = tell_line
    ) -> None:
        self._log = log
        self._say = say
        self._name = name
        self._whole = whole
        self._encoder = msgspec.json.Encoder(enc_hook=encode_other)
        self._shown_ns: dict[str, int] = {}

    def write(self, topic: str, stamp_ns: int, record: Mapping[str, Any]) -> None:
        if self._whole or topic not in OFTEN:
            self._log.write(topic, stamp_ns, record)
        if stamp_ns - self._shown_ns.get(topic, -(1 << 62)) >= WATCHED.get(topic, math.inf) * 1e9:
            self._shown_ns[topic] = stamp_ns
            shown = self._encoder.encode(
                {"event": "record", "record": [self._name, topic, stamp_ns, record]}
            )
            self._say(shown.decode())

    def image(self, topic: str, stamp_ns: int, image: Any) -> None:
        if self._whole:
            self._log.image(topic, stamp_ns, image)

    def frame(self, frame: Frame) -> None:
        if self._whole and isinstance(self._log, FrameLog):
            self._log.frame(frame)


FarFlight = Callable[[FarBase, str, ProgramContext], DroneFlight]


async def _fly(
    flight: FarFlight, name: str, log: Log, store: StateFile, say: Callable[[str], None]
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

    return await flight(base, name, ProgramContext(log, show, stop, None, store)).run()


def _drone(config: RelayConfig, name: str) -> NamedDrone:
    return next(drone for drone in config.drones if drone.name == name)


def fly(flight: FarFlight, name: str, out: Path, whole: bool) -> None:
    with McapLog(new_part(out, name), name) as log, Said(sys.stdout) as say:
        store = StateFile(out / f"{name}.state.json", None)
        relayed = RelayedLog(log, name, whole, say)
        result = asyncio.run(_fly(flight, name, relayed, store, say))
        lost = f"{say.lost} lines of it found no room on the way to the monitors"
        say(encode_event(with_log(result, log.settled() or (lost if say.lost else None))))


def guard(rig: Rig, config: RelayConfig, name: str, out: Path) -> int:
    """Watch the drone's vehicle until stdin is closed."""
    own = pair_of(rig, _drone(config, name), _drone(config, name))
    assert own.receiver.guard is not None, f"{name} has no guard"
    logs = {Role.RECEIVER: out / f"{name}.guard.mcap"}
    return asyncio.run(
        watch_vehicles(
            own, rig_library.mission_of(rig), {Role.RECEIVER: own.receiver.guard}, logs,
            until_input_ends=True, while_flown=False,
        )
    )  # fmt: skip


def main(config_of: Callable[[Rig, str], tuple[RelayConfig, FarFlight]]) -> None:
    """The program of the process. ``config_of``: what of the rig takes part, and how one of its
    drones flies.
    """
    what, rig_file, size, name, folder, *logs = sys.argv[1:]
    rig = rig_library.load_unchecked(rig_file)
    config, flight = config_of(rig, size)
    if what == "guard":
        sys.exit(guard(rig, config, name, Path(folder)))
    fly(flight, name, Path(folder), logs == ["whole"])


def _of_a_relay(rig: Rig, drones: str) -> tuple[RelayConfig, FarFlight]:
    config = relay_of(rig, int(drones))
    return config, partial(DroneFlight, rig, config)


if __name__ == "__main__":
    main(_of_a_relay)
