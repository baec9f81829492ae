"""The autopilot's parameters a companion-driven flight needs: read, compared with the rig, set when
asked to.
"""

from __future__ import annotations

import asyncio
import math
import threading
from collections.abc import Awaitable, Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

from mavsdk.plugins.param import Param, ParamError, ParamResult

from drivers.interfaces import VehicleError
from path.values import frozen

RENAMED: Mapping[str, tuple[str, ...]] = {"MAV_GCS_SYSID": ("SYSID_MYGCS",)}  # ArduPilot before 4.7
"""The name of a parameter in older versions of its autopilot."""

T = TypeVar("T")

CLOSE = 1e-4  # of a single-precision number
OTHER_TYPE = (ParamResult.WRONG_TYPE, ParamResult.TYPE_MISMATCH)
# an autopilot does not answer for what it has not got
ABSENT = (ParamResult.DOES_NOT_EXIST, ParamResult.TIMEOUT)


@frozen
class Difference:
    """A parameter that is not as the rig wants it. ``found`` is None where the vehicle has no such
    parameter.
    """

    name: str
    wanted: float
    found: float | None

    def __str__(self) -> str:
        found = "not there" if self.found is None else f"{self.found:g}"
        return f"{self.name} is {found}, the rig wants {self.wanted:g}"


def differences(
    wanted: Mapping[str, float], found: Mapping[str, float | None]
) -> tuple[Difference, ...]:
    """Return the parameters that are not as wanted, in the order of the rig. Both by the rig's
    names.
    """
    pairs = ((name, value, found.get(name)) for name, value in wanted.items())
    return tuple(
        Difference(*pair) for pair in pairs if pair[2] is None or not same(pair[1], pair[2])
    )


def same(wanted: float, found: float) -> bool:
    """Equal as far as a single-precision number can say."""
    return math.isclose(wanted, found, rel_tol=CLOSE, abs_tol=1e-6)


class ParameterAccess:
    """Reads and sets through MAVSDK's Param plugin, whose calls block: each runs in a thread of its
    own.
    """

    def __init__(self, system: Any) -> None:
        self._plugin: Any = Param(system)
        self._in_use = threading.Lock()
        # ends with this, not with the program
        self._thread = ThreadPoolExecutor(1, "mavsdk-parameters")

    def destroy(self) -> None:
        """End the plugin, once the call that it is in has returned: cancelling the reader does not
        end that.
        """
        with self._in_use:
            self._plugin.destroy()
        self._thread.shutdown()

    async def read(self, names: Iterable[str]) -> dict[str, float | None]:
        """Values by the names asked for, None for one that the vehicle does not have. Raises
        VehicleError.
        """
        return {name: await self._apart(self._read_known, name) for name in names}

    async def write(self, difference: Difference) -> None:
        """Set one parameter that ``read`` has found, and confirm it. Raises VehicleError."""
        await self._apart(self._write, difference.name, difference.wanted)

    def _apart(self, call: Callable[..., T], *args: Any) -> Awaitable[T]:
        return asyncio.get_running_loop().run_in_executor(self._thread, call, *args)

    def _read_known(self, name: str) -> float | None:
        with self._in_use:
            for known in (name, *RENAMED.get(name, ())):
                found = self._read(known)
                if found is not None:
                    return found[0]
            return None

    def _read(self, name: str) -> tuple[float, bool] | None:
        """(value, whether it is a whole number)."""
        for whole, get in (
            (True, self._plugin.get_param_int),
            (False, self._plugin.get_param_float),
        ):
            try:
                return float(get(name)), whole
            except ParamError as error:
                if error.result in OTHER_TYPE:
                    continue
                if error.result in ABSENT:
                    return None
                what = f"parameter {name} cannot be read: {error.result.name}"
                raise VehicleError(what, "check cable or radio") from error
        return None

    def _write(self, name: str, wanted: float) -> None:
        with self._in_use:
            for known in (name, *RENAMED.get(name, ())):
                found = self._read(known)
                if found is None:
                    continue
                try:
                    if found[1]:
                        self._plugin.set_param_int(known, round(wanted))
                    else:
                        self._plugin.set_param_float(known, wanted)
                except ParamError as error:
                    raise VehicleError(
                        f"{known} = {wanted:g} was not taken: {error.result.name}"
                    ) from error
                after = self._read(known)
                if after is None or not same(wanted, after[0]):
                    raise VehicleError(f"{known} was set to {wanted:g} and is {after and after[0]}")
                return
            raise VehicleError(
                f"the vehicle has no parameter {name}",
                "is it the right kind and version of autopilot?",
            )
