"""Compile every kernel that a run will use, or load it compiled, before the run's clock starts.

At the first start two processes compile different parts: compiling keeps one core busy, whatever
the number of threads.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager

from drivers.rig.parts import Rig, import_factory
from flight.harness.flights import Progress
from path.messages import Role

RENDERED = ("renderer", "depth", "relative", "cycles", "physics"), ("marker", "pose")
FROM_GEOMETRY = ("geometry", "cycles", "physics"), ("pose", "relative")
"""Parts that this process compiles, and that another one does meanwhile: about as much."""
_prepared: set[str] = set()  # parts of this process
HELP_WITHIN_S = 600.0  # then what the other process has not compiled is compiled here


def starting(role: Role, what: str) -> Progress:
    """Return what the console shows while there is no role yet."""
    return Progress(role, 0, "starting", 0, 0, None, None, None, 0.0, False, what)


def prepare(rig: Rig, say: Callable[[str], None]) -> None:
    """The physics, the marker finder, and what the perception of this rig computes.

    Once in a process: a program that flies many times compiled at its first flight at the latest.
    """
    from path.marker.warm_up import is_compiled  # noqa: PLC0415 (numba: not for who only starts programs)

    rendered = any("camera" in rig.role(role).perception.options for role in Role)
    parts = RENDERED if rendered else FROM_GEOMETRY
    own, others = ([name for name in names if name not in _prepared] for names in parts)
    first = not _prepared and not is_compiled()
    with helped(others if first and (os.cpu_count() or 1) > 1 else ()):
        _carry_out(own, first, len(own) + len(others), 0, say)
    _carry_out(others, first, len(own) + len(others), len(own), say)


def _carry_out(
    names: Sequence[str], first: bool, of: int, done: int, say: Callable[[str], None]
) -> None:
    for number, name in enumerate(names, done):
        say(
            f"preparing: {'compiling' if first else 'loading'} kernels, {of - number} of {of} parts left ({name})"
        )
        compile_part(name)
        _prepared.add(name)


@contextmanager
def helped(names: Sequence[str]) -> Generator[None]:
    """While another process compiles some parts, which are then found compiled. It is waited for,
    not for ever.
    """
    if not names:
        yield
        return
    command = [sys.executable, "-m", "hil.harness.preparation", *names]
    process = subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        yield
        process.wait(HELP_WITHIN_S)
    except subprocess.TimeoutExpired:
        pass  # compiled here then
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()


def physics() -> None:
    """Compile what steps a world."""
    from hil.world.config import WorldConfig  # noqa: PLC0415 (each process imports what it compiles)
    from hil.world.world import World  # noqa: PLC0415

    world = World(WorldConfig(), seed=0)
    world.advance(0.1)
    world.snapshot()


PARTS: Mapping[str, Sequence[str]] = {
    "pose": ("path.marker.warm_up:warm_up_pose",),
    "relative": ("path.marker.warm_up:warm_up_relative",),
    "cycles": ("path.cycle.warm_up:warm_up_cycles", "path.belief.warm_up:warm_up_belief"),
    "marker": ("path.marker.warm_up:warm_up_image",),
    "common view": ("flight.common_view:warm_up",),
    "physics": (f"{__name__}:physics",),
    "geometry": ("hil.geometric.perception:warm_up",),
    "renderer": ("hil.render.renderer:warm_up",),
    "depth": ("hil.render.depth:warm_up", "drivers.realsense.registration:warm_up"),
}
"""The functions that compile each part, named: each process imports what it compiles, and no
more.
"""


def compile_part(name: str) -> None:
    """Compile one part, or load it compiled."""
    for function in PARTS[name]:
        import_factory(function, f"part {name}")()


if __name__ == "__main__":
    for part in sys.argv[1:]:
        compile_part(part)
