"""``path-handoff doctor --rehearse``: every part's test against stand-ins, before there is hardware.

The world of a rig in real time is a process: vehicles, guards' links, cameras and the link between
the drones, with nobody flying. Both roles are tested at once, as on two computers.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from dataclasses import replace
from multiprocessing import TimeoutError as NotYet
from multiprocessing import get_context
from multiprocessing.pool import IMapIterator
from multiprocessing.synchronize import Event
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Timer

from drivers.interfaces import PartError
from drivers.rig.part_check import Finding
from drivers.rig.parts import Rig
from drivers.rig.toml_text import toml_text
from missions.field.doctor.parts import part_tests, run_test
from missions.fly.handoff.served import RUN_VARIABLE
from missions.fly.rehearse import rehearsed
from missions.ground import rig_library
from missions.ground.work import belong_to_parent
from path.messages import Role

WORLD = "hil.harness.realtime.handoff_world"
STAND_INS = "sitl-field"  # vehicles that obey parameters, with radios and fences of their own
SEED = "0"
READY_S = 180.0  # the first start of all compiles kernels
END_S = 20.0
_ready: list[Event] = []  # of a role's process: set once the world is ready


def rehearsal(name: str, doing: Callable[[str], None]) -> Iterator[Finding]:
    """Yield what both roles' tests find of a rig's stand-ins. Raises PartError."""
    with TemporaryDirectory(prefix="path-rehearsal-") as folder:
        rig = _stood_in(name, Path(folder))
        doing("stand-ins of both drones, their cameras and their link")
        run = f"run-{os.getpid()}"
        spawning = get_context("spawn")
        ready = spawning.Event()
        # Both roles' programs load while the world does: beside one that draws they take three times as long.
        with spawning.Pool(len(Role), _begin, (run, ready)) as pool:
            tested = pool.imap(_tested, [(str(rig.file), role.value) for role in Role])
            with _world(rig, Path(folder), run):
                doing("both roles at once, some 20 s: vehicle, guard, perception, link")
                ready.set()
                for _ in Role:
                    yield from _found(tested)


def _found(tested: IMapIterator[list[Finding]]) -> list[Finding]:
    """Wait for one role's findings. Raises PartError when its program does not come to an end."""
    try:
        return tested.next(READY_S)
    except NotYet:
        raise PartError(
            f"a role's tests have not ended within {READY_S:g} s",
            "free the computer, and look again",
        ) from None


def _stood_in(name: str, folder: Path) -> Rig:
    """Return the rig with the hardware of the harness; one that has it is taken as it is."""
    rig = rig_library.load(name)
    if rig.harness is None:
        file = folder / f"{rig.name}.rig.toml"
        text = toml_text(rehearsed(rig, STAND_INS), f"{rig.name}, for doctor --rehearse.")
        file.write_text(text, "utf-8")
        return rig_library.load(str(file))
    if rig.level != "sitl":
        raise PartError(
            f"--rehearse: rig {rig.name} has no parts that could be tested at level {rig.level}",
            "add --level sitl, or name a rig that you made for the field",
        )
    return rig


@contextmanager
def _world(rig: Rig, folder: Path, run: str) -> Generator[None]:
    """A rig's world as a process of its own, ready, which ends with its input. Raises PartError.

    Args:
        run: by which name cameras' drivers find its frames.
    """
    own = [str(rig.file), SEED, "careful", str(folder), "--", *map(str, rig.folders)]
    errors = folder / "world.stderr.txt"
    with (
        errors.open("wb") as stderr,
        subprocess.Popen(
            [sys.executable, "-m", WORLD, *own],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=stderr,
            env={**os.environ, RUN_VARIABLE: run},
        ) as world,
    ):
        late = Timer(READY_S, world.kill)
        late.start()
        try:
            assert world.stdout is not None
            event = {"event": "", "what": ""}
            for line in world.stdout:
                event = json.loads(line)
                if event["event"] == "ready":
                    break
            late.cancel()
            if event["event"] != "ready":
                words = errors.read_text("utf-8", errors="replace").strip().splitlines()
                raise PartError(
                    f"the stand-ins did not start: {' '.join([event['what'], *words[-1:]])}",
                    "is another flight going on? End it, and look again",
                )
            yield
        finally:
            late.cancel()
            _end(world)


def _end(world: subprocess.Popen[bytes]) -> None:
    try:
        world.communicate(timeout=END_S)
    except subprocess.TimeoutExpired:
        world.kill()


def _begin(run: str, ready: Event) -> None:
    belong_to_parent()
    os.environ[RUN_VARIABLE] = run
    _ready.append(ready)


def _tested(asked: tuple[str, str]) -> list[Finding]:
    """Return what one role's tests find, in a process of its own. ``asked``: rig file and role."""
    rig_file, role = asked
    rig = replace(rig_library.load(rig_file), harness=None)
    tests = list(part_tests(rig, Role(role)))
    _ready[0].wait(READY_S)
    return [finding for test in tests for finding in run_test(test)]
