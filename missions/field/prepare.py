"""``path-handoff prepare``: compiles the kernels of a rig now, so that no later start does."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable

from drivers.rig.parts import Rig, import_factory
from flight.command_end import CommandEnd
from missions.ground import rig_library
from missions.ground.kernel_cache import INSTALLED, VARIABLE, can_write, users_cache
from missions.ground.options.field import PrepareOptions


def run(options: PrepareOptions) -> int:
    """Compile, or find compiled, what the rig will use; says where it is kept. Raises PartError,
    RigError.
    """
    rig = rig_library.load(options.rig)
    start_s = time.perf_counter()
    prepare(rig)
    sys.stdout.write(
        f"kernels for rig {rig.name} are ready after {time.perf_counter() - start_s:.1f} s\n"
    )
    sys.stdout.write(f"kept in {kept_in()}, for this user, this processor and these sources\n")
    return CommandEnd.DONE.exit_code


def prepare(rig: Rig) -> None:
    """Prepares what the rig's harness needs before its clock starts; without one, what a role
    compiles on its drone.
    """
    harness = None if rig.harness is None else import_factory(rig.harness, rig.where("harness"))
    by_harness: Callable[[Rig, Callable[[str], None]], None] | None = getattr(
        harness, "prepare", None
    )
    if by_harness is not None:
        by_harness(rig, _say)
        return
    from drivers.realsense.registration import warm_up as warm_up_registration  # noqa: PLC0415 (a harness does without)
    from path.marker.warm_up import warm_up  # noqa: PLC0415

    warm_up()
    warm_up_registration()


def _say(what: str) -> None:
    sys.stdout.write(f"{what}\n")
    sys.stdout.flush()


def kept_in() -> str:
    """Return the folder that numba keeps compiled kernels in."""
    named = os.environ.get(VARIABLE)
    if named:
        return named
    beside = INSTALLED / "path"
    cache = users_cache()
    if cache is None or can_write(beside):
        return f"{INSTALLED}, beside the sources"
    return str(cache / "numba")
