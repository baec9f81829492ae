"""A mission's file, and which of its coroutines flies which drone."""

from __future__ import annotations

import importlib.util
import inspect
import sys
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path
from types import ModuleType

from drivers.interfaces import PartError
from drivers.rig.parts import ended_by
from drivers.text_file import is_file
from missions.own.drone import Drone
from path.messages import Role

Mission = Callable[[Drone], Awaitable[None]]

BOTH = "mission"
MODULE = "path_own_mission"
_REMEDY = "write `async def mission(drone)`, or `async def sender(drone)` and `async def receiver(drone)`"


def load_mission(file: Path) -> Mapping[Role, Mission]:
    """Returns each drone's mission: ``mission`` for both, or ``sender`` and ``receiver`` one each. Raises PartError."""
    module = _module(file)
    both = getattr(module, BOTH, None)
    return {role: _coroutine(file, role, getattr(module, role.value, both)) for role in Role}


def _module(file: Path) -> ModuleType:
    if not is_file(file):
        raise PartError(f"there is no mission {file}", "name the Python file of a mission (docs/own-missions.md)")
    spec = importlib.util.spec_from_file_location(MODULE, file)
    if spec is None or spec.loader is None:
        raise PartError(f"{file} is no Python file", "name the mission's file, which ends in .py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[MODULE] = module  # where its dataclasses look for themselves
    try:
        spec.loader.exec_module(module)
    except SystemExit as error:
        raise PartError(f"{file} cannot be loaded: it {ended_by(error)}", "mend the file") from error
    except Exception as error:
        raise PartError(f"{file} cannot be loaded: {type(error).__name__}: {error}", "mend the file") from error
    return module


def _coroutine(file: Path, role: Role, found: object) -> Mission:
    if found is None:
        raise PartError(f"{file} has nothing that flies the {role.value}", _REMEDY)
    if not inspect.iscoroutinefunction(found):
        raise PartError(f"{file}: what flies the {role.value} is no `async def`", _REMEDY)
    return found
