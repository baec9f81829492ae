"""Compile every kernel that a run will use, or load it compiled, before the run's clock starts.

At the first start two processes compile different parts: compiling keeps one core busy, whatever the number of threads.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager

from drivers.rig.parts import Rig
from flight.harness.flights import Progress
from path.messages import Role

RENDERED = ("renderer", "depth", "relative", "cycles", "physics"), ("marker", "pose")
FROM_GEOMETRY = ("geometry", "cycles", "physics"), ("pose", "relative")
"""Parts that this process compiles, and that another one does meanwhile: about as much."""
HELP_WITHIN_S = 600.0  # then what the other process has not compiled is compiled here


def starting(role: Role, what: str) -> Progress:
    """Returns what the console shows while there is no role yet."""
    return Progress(role, 0, "starting", 0, 0, None, None, None, 0.0, False, what)


def prepare(rig: Rig, say: Callable[[str], None]) -> None:
    """The physics, the marker finder, and what the perception of this rig computes."""
    from path.marker.warm_up import is_compiled  # noqa: PLC0415 (numba: not for who only starts programs)

    rendered = any("camera" in rig.role(role).perception.options for role in Role)
    own, others = RENDERED if rendered else FROM_GEOMETRY
    first = not is_compiled()
    with helped(others if first and (os.cpu_count() or 1) > 1 else ()):
        _carry_out(own, first, len(own) + len(others), 0, say)
    _carry_out(others, first, len(own) + len(others), len(own), say)


def _carry_out(names: Sequence[str], first: bool, of: int, done: int, say: Callable[[str], None]) -> None:
    for number, name in enumerate(names, done):
        say(f"preparing: {'compiling' if first else 'loading'} kernels, {of - number} of {of} parts left ({name})")
        PARTS[name]()


@contextmanager
def helped(names: Sequence[str]) -> Generator[None]:
    """While another process compiles some parts, which are then found compiled. It is waited for, not for ever."""
    if not names:
        yield
        return
    command = [sys.executable, "-m", "hil.harness.preparation", *names]
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield
        process.wait(HELP_WITHIN_S)
    except subprocess.TimeoutExpired:
        pass  # compiled here then
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()


def _pose() -> None:
    from path.marker.warm_up import warm_up_pose  # noqa: PLC0415

    warm_up_pose()


def _relative() -> None:
    from path.marker.warm_up import warm_up_relative  # noqa: PLC0415

    warm_up_relative()


def _cycles() -> None:
    from path.cycle.warm_up import warm_up_cycles  # noqa: PLC0415

    warm_up_cycles()


def _marker() -> None:
    from path.marker.warm_up import warm_up_image  # noqa: PLC0415

    warm_up_image()


def _physics() -> None:
    from hil.world.config import WorldConfig  # noqa: PLC0415 (each process imports what it compiles)
    from hil.world.world import World  # noqa: PLC0415

    world = World(WorldConfig(), seed=0)
    world.advance(0.1)
    world.snapshot()


def _geometry() -> None:
    from hil.geometric.perception import warm_up  # noqa: PLC0415 (rendered levels do without)

    warm_up()


def _renderer() -> None:
    from hil.render.renderer import warm_up  # noqa: PLC0415 (sim does without)

    warm_up()


def _depth() -> None:
    from drivers.realsense.registration import warm_up as warm_up_registration  # noqa: PLC0415 (sim does without)
    from hil.render.depth import warm_up as warm_up_depth  # noqa: PLC0415

    warm_up_depth()
    warm_up_registration()


PARTS: Mapping[str, Callable[[], None]] = {
    "pose": _pose,
    "relative": _relative,
    "cycles": _cycles,
    "marker": _marker,
    "physics": _physics,
    "geometry": _geometry,
    "renderer": _renderer,
    "depth": _depth,
}


if __name__ == "__main__":
    for part in sys.argv[1:]:
        PARTS[part]()
