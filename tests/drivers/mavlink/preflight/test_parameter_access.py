"""Parameters by MAVSDK's plugin, on one that stands in: whole numbers and others, old names, and
what is not taken.
"""

from __future__ import annotations

import asyncio
import threading
from typing import Any

import pytest
from mavsdk.plugins.param import ParamError, ParamResult

from drivers.interfaces import VehicleError
from drivers.mavlink.preflight import parameters
from drivers.mavlink.preflight.parameters import Difference, ParameterAccess, same


class Plugin:
    """An autopilot's parameters, each of its own type."""

    def __init__(self) -> None:
        self.whole = {"COM_RC_IN_MODE": 3, "SYSID_MYGCS": 255}
        self.real = {"MIS_TAKEOFF_ALT": 2.5}
        self.fails: dict[str, ParamResult] = {}
        self.keeps = True
        self.threads: set[str] = set()
        self.destroyed = False

    def _check(self, name: str, own: dict[str, Any], other: dict[str, Any]) -> None:
        self.threads.add(threading.current_thread().name)
        result = self.fails.get(name)
        if result is None and name in other:
            result = ParamResult.WRONG_TYPE
        if result is None and name not in own:
            result = ParamResult.DOES_NOT_EXIST
        if result is not None:
            raise ParamError(result, "x")

    def get_param_int(self, name: str) -> int:
        self._check(name, self.whole, self.real)
        return self.whole[name]

    def get_param_float(self, name: str) -> float:
        self._check(name, self.real, self.whole)
        return self.real[name]

    def set_param_int(self, name: str, value: int) -> None:
        self._check(f"set {name}" if f"set {name}" in self.fails else name, self.whole, self.real)
        assert type(value) is int
        if self.keeps:
            self.whole[name] = value

    def set_param_float(self, name: str, value: float) -> None:
        self._check(name, self.real, self.whole)
        if self.keeps:
            self.real[name] = value

    def destroy(self) -> None:
        self.destroyed = True


@pytest.fixture
def plugin(monkeypatch: pytest.MonkeyPatch) -> Plugin:
    made = Plugin()

    def make(system: object) -> Plugin:
        assert system == "a system"
        return made

    monkeypatch.setattr(parameters, "Param", make)
    return made


def read(*names: str) -> dict[str, float | None]:
    async def main() -> dict[str, float | None]:
        access = ParameterAccess("a system")
        found = await access.read(names)
        access.destroy()
        return found

    return asyncio.run(main())


def write(name: str, wanted: float) -> None:
    async def main() -> None:
        access = ParameterAccess("a system")
        try:
            await access.write(Difference(name, wanted, None))
        finally:
            access.destroy()

    asyncio.run(main())


def test_whole_numbers_and_others_are_read_and_what_is_not_there_is_none(plugin: Plugin) -> None:
    plugin.fails["SLOW"] = ParamResult.TIMEOUT
    found = read("COM_RC_IN_MODE", "MIS_TAKEOFF_ALT", "NONE", "SLOW")
    assert found == {"COM_RC_IN_MODE": 3.0, "MIS_TAKEOFF_ALT": 2.5, "NONE": None, "SLOW": None}
    assert all(name.startswith("mavsdk-parameters") for name in plugin.threads)
    assert plugin.destroyed


def test_a_parameter_that_had_another_name_is_found_by_it(plugin: Plugin) -> None:
    assert read("MAV_GCS_SYSID") == {"MAV_GCS_SYSID": 255.0}
    write("MAV_GCS_SYSID", 246.0)
    assert plugin.whole["SYSID_MYGCS"] == 246
    plugin.whole["MAV_GCS_SYSID"] = 1
    assert read("MAV_GCS_SYSID") == {"MAV_GCS_SYSID": 1.0}


@pytest.mark.parametrize("result", [ParamResult.WRONG_TYPE, ParamResult.TYPE_MISMATCH])
def test_a_parameter_of_neither_type_is_none(plugin: Plugin, result: ParamResult) -> None:
    plugin.fails["ODD"] = result
    assert read("ODD") == {"ODD": None}


def test_a_parameter_that_cannot_be_read_is_a_fault(plugin: Plugin) -> None:
    plugin.fails["COM_RC_IN_MODE"] = ParamResult.CONNECTION_ERROR
    with pytest.raises(VehicleError, match="COM_RC_IN_MODE cannot be read: CONNECTION_ERROR"):
        read("COM_RC_IN_MODE")


def test_a_parameter_is_set_in_its_own_type_and_read_again(plugin: Plugin) -> None:
    write("COM_RC_IN_MODE", 5.0)
    write("MIS_TAKEOFF_ALT", 1.5)
    assert plugin.whole["COM_RC_IN_MODE"] == 5 and plugin.real["MIS_TAKEOFF_ALT"] == 1.5


def test_a_parameter_that_is_not_taken_says_why(plugin: Plugin) -> None:
    with pytest.raises(VehicleError, match="has no parameter NONE"):
        write("NONE", 1.0)
    plugin.fails["set COM_RC_IN_MODE"] = ParamResult.CONNECTION_ERROR
    with pytest.raises(VehicleError, match="COM_RC_IN_MODE = 5 was not taken: CONNECTION_ERROR"):
        write("COM_RC_IN_MODE", 5.0)
    plugin.keeps = False
    with pytest.raises(VehicleError, match=r"MIS_TAKEOFF_ALT was set to 1.5 and is 2.5"):
        write("MIS_TAKEOFF_ALT", 1.5)


def test_a_parameter_that_is_gone_after_it_was_set_was_not_taken(plugin: Plugin) -> None:
    def lose(name: str, value: int) -> None:
        del plugin.whole[name]

    plugin.set_param_int = lose
    with pytest.raises(VehicleError, match="COM_RC_IN_MODE was set to 5 and is None"):
        write("COM_RC_IN_MODE", 5.0)


def test_the_plugin_is_not_destroyed_under_a_call_that_it_is_in(plugin: Plugin) -> None:
    access = ParameterAccess("a system")
    begun, go_on = threading.Event(), threading.Event()

    def wait(name: str) -> int:
        assert name
        begun.set()
        assert go_on.wait(5.0) and not plugin.destroyed
        return 1

    plugin.get_param_int = wait
    reading = threading.Thread(target=access._read_known, args=("COM_RC_IN_MODE",))
    reading.start()
    assert begun.wait(5.0)
    ending = threading.Thread(target=access.destroy)
    ending.start()
    ending.join(0.02)
    assert not plugin.destroyed
    go_on.set()
    ending.join(5.0)
    reading.join(5.0)
    assert plugin.destroyed


@pytest.mark.parametrize(
    ("wanted", "found", "alike"),
    [
        (2.5, 2.5, True),
        (1000.0, 1000.09, True),
        (1000.0, 1000.2, False),
        (0.0, 1e-7, True),
        (0.0, 1e-5, False),
    ],
)
def test_numbers_are_the_same_as_far_as_single_precision_goes(
    wanted: float, found: float, alike: bool
) -> None:
    assert same(wanted, found) is alike


def test_a_difference_is_told_in_words() -> None:
    assert str(Difference("A", 2.0, 3.5)) == "A is 3.5, the rig wants 2"
    assert str(Difference("A", 2.0, None)) == "A is not there, the rig wants 2"
