"""A mission's file, and which of its coroutines flies which drone."""

from __future__ import annotations

import inspect
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path

from drivers.interfaces import PartError
from drivers.rig.own_file import module_of
from missions.fly.own.drone import Drone
from path.messages import Role

Mission = Callable[[Drone], Awaitable[None]]

BOTH = "mission"
_REMEDY = (
    "write `async def mission(drone)`, or `async def sender(drone)` and `async def receiver(drone)`"
)


def load_mission(file: Path) -> Mapping[Role, Mission]:
    """Return each drone's mission: ``mission`` for both, or ``sender`` and ``receiver`` one each.
    Raises PartError.
    """
    module = module_of(file, "mission")
    both = getattr(module, BOTH, None)
    return {role: _coroutine(file, role, getattr(module, role.value, both)) for role in Role}


def _coroutine(
    file: Path,
    role: Role,
    found: object,
) -> Mission:
    if found is None:
        raise PartError(f"{file} has nothing that flies the {role.value}", _REMEDY)
    if not inspect.iscoroutinefunction(found):
        raise PartError(f"{file}: what flies the {role.value} is no `async def`", _REMEDY)
    return found
