"""Which answer is believed: of the command that was sent, after it was sent. Without MAVSDK and
without a vehicle.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as mavlink

from drivers.interfaces import FlightMode, VehicleError
from drivers.mavlink.guard_link import GuardMavlink, GuardMavlinkConfig
from drivers.mavlink.session import ACCEPTED, IN_PROGRESS, MavsdkSession
from drivers.mavlink.telemetry import TelemetrySlots
from drivers.mavlink.vehicle_config import MavsdkVehicleConfig
from hil.harness.virtual_time import run_virtual
from tests.drivers.mavlink.mavsdk_bench import CONTEXT, SYSID, TANGENT, LoopClock

TAKE_OFF, LAND, SET_MODE = 22, 21, 176
DENIED = 2


class Direct:
    """In the place of MAVSDK's way to the vehicle: what was sent, and what the vehicle does about
    it.
    """

    def __init__(self, on_sent: Callable[[dict[str, Any]], object]) -> None:
        self.sent: list[dict[str, Any]] = []
        self._on_sent = on_sent

    def send_message(self, message: Any) -> None:
        self.sent.append(json.loads(message.fields_json))
        self._on_sent(self.sent[-1])


class Session:
    """A session that is open to a vehicle that beats; ``acks`` are what it answers, after each
    command.
    """

    def __init__(self, *acks: tuple[int, int], **options: Any) -> None:
        self.telemetry = TelemetrySlots(SYSID, LoopClock(), TANGENT)
        config = MavsdkVehicleConfig(
            url="udpin://127.0.0.1:14540", sysid=SYSID, command_timeout_s=0.5, **options
        )
        self.session = MavsdkSession(config, self.telemetry)
        self.direct = Direct(lambda _: [self.ack(*each) for each in acks])
        opened: Any = self.session
        opened._direct = self.direct

    def ack(self, command: int, result: int, sysid: int = SYSID) -> None:
        fields = json.dumps({"command": command, "result": result})
        self.telemetry._on_ack(SimpleNamespace(system_id=sysid, component_id=1, fields_json=fields))

    async def command(self, command: int, tries: int = 1) -> int | None:
        self.telemetry.check()  # its clock follows the role's
        beating = asyncio.create_task(self._beat())
        await asyncio.sleep(0)
        try:
            return await self.session.command(command, (1.0,), tries)
        finally:
            beating.cancel()

    async def _beat(self) -> None:
        fields = json.dumps({"autopilot": 12, "base_mode": 1, "custom_mode": 0})
        while True:
            self.telemetry._on_heartbeat(
                SimpleNamespace(system_id=SYSID, component_id=1, fields_json=fields)
            )
            await asyncio.sleep(0.05)


def commanded(session: Session, command: int, tries: int = 1) -> int | None:
    return asyncio.run(session.command(command, tries))


@pytest.mark.parametrize("result", [ACCEPTED, DENIED])
def test_the_answer_to_a_command_is_its_own(result: int) -> None:
    assert commanded(Session((TAKE_OFF, result)), TAKE_OFF) == result


def test_an_answer_to_another_command_is_none() -> None:
    assert commanded(Session((LAND, ACCEPTED)), TAKE_OFF) is None


def test_an_answer_that_came_before_the_command_is_none() -> None:
    """The take-off before was accepted: nothing is known of this one."""

    async def twice() -> int | None:
        session = Session()
        session.ack(TAKE_OFF, ACCEPTED)
        return await session.command(TAKE_OFF)

    assert asyncio.run(twice()) is None


def test_an_answer_to_the_first_try_is_none_to_the_second() -> None:
    session = Session((LAND, IN_PROGRESS))
    assert commanded(session, TAKE_OFF, tries=3) is None
    assert [each["confirmation"] for each in session.direct.sent] == [0, 1, 2]


def test_another_vehicles_answer_is_none() -> None:
    session = Session()

    async def command() -> int | None:
        asyncio.get_running_loop().call_later(0.1, session.ack, TAKE_OFF, ACCEPTED, SYSID + 1)
        return await session.command(TAKE_OFF)

    assert asyncio.run(command()) is None


def test_a_vehicle_that_is_at_it_has_time_and_says_the_end_itself() -> None:
    """In progress is no end; three seconds after it was last said it may still come."""
    session = Session((TAKE_OFF, IN_PROGRESS))

    async def ends() -> int | None:
        asyncio.get_running_loop().call_later(1.2, session.ack, TAKE_OFF, DENIED)
        return await session.command(TAKE_OFF)

    assert asyncio.run(ends()) == DENIED


def test_motors_are_not_stopped_in_the_air_by_force() -> None:
    async def force() -> None:
        await Session().session.command(400, (0.0, 21196.0))

    with pytest.raises(VehicleError, match="never sent"):
        asyncio.run(force())


# --- the guard's link


class Port:
    """In the place of the guard's port: what was sent, and what waits to be read."""

    def __init__(self) -> None:
        self.sent: list[Any] = []
        self.waiting: list[Any] = []

    def read(self) -> list[Any]:
        waiting, self.waiting = self.waiting, []
        return waiting

    def send(self, message: Any) -> None:
        self.sent.append(message)


class Link:
    """The guard's link to a PX4 in the air that beats."""

    def __init__(self) -> None:
        config = GuardMavlinkConfig(
            url="udpin://127.0.0.1:14551", bind="127.0.0.1:14561", vehicle_sysid=SYSID
        )
        self.link = GuardMavlink(config, CONTEXT)
        self.port = Port()
        opened: Any = self.link
        opened._port = self.port
        self.says(mavlink.MAVLink_heartbeat_message(2, 12, 129, 6 << 16, 4, 3))

    def says(self, message: Any) -> Any:
        """The guard's view after a message."""
        mav = mavlink.MAVLink(None, srcSystem=SYSID, srcComponent=1)
        self.port.waiting.append(mav.decode(bytearray(message.pack(mav))))
        view = self.link.view()
        assert view is not None
        return view


def in_time(check: Callable[[Link], object]) -> None:
    async def main() -> None:
        check(Link())

    run_virtual(main())


@pytest.mark.parametrize("result", [ACCEPTED, DENIED])
def test_the_guards_command_is_answered_by_its_own_acknowledgement(result: int) -> None:
    def check(guard: Link) -> None:
        guard.link.land()
        assert guard.says(mavlink.MAVLink_command_ack_message(SET_MODE, ACCEPTED)).acked is None
        assert guard.says(mavlink.MAVLink_command_ack_message(LAND, IN_PROGRESS)).acked is None
        assert guard.says(mavlink.MAVLink_command_ack_message(LAND, result)).acked is (
            result == ACCEPTED
        )

    in_time(check)


def test_an_acknowledgement_of_the_command_before_says_nothing_of_the_next() -> None:
    def check(guard: Link) -> None:
        # somebody else's
        assert guard.says(mavlink.MAVLink_command_ack_message(LAND, ACCEPTED)).acked is None
        guard.link.hold()
        assert guard.says(mavlink.MAVLink_command_ack_message(SET_MODE, ACCEPTED)).acked is True
        guard.link.land()
        view = guard.link.view()
        assert view is not None and view.acked is None
        assert guard.says(mavlink.MAVLink_command_ack_message(SET_MODE, ACCEPTED)).acked is None

    in_time(check)


@pytest.mark.parametrize(
    ("landed", "in_air"),
    [
        (mavlink.MAV_LANDED_STATE_ON_GROUND, False),
        (mavlink.MAV_LANDED_STATE_IN_AIR, True),
        (mavlink.MAV_LANDED_STATE_TAKEOFF, True),
        (mavlink.MAV_LANDED_STATE_LANDING, True),
        (mavlink.MAV_LANDED_STATE_UNDEFINED, True),
    ],
)
def test_only_what_stands_on_the_ground_is_not_in_the_air(landed: int, in_air: bool) -> None:
    """A vehicle that takes off or lands falls when its motors stop; so may one that does not
    know.
    """

    def check(guard: Link) -> None:
        guard.says(
            mavlink.MAVLink_extended_sys_state_message(0, mavlink.MAV_LANDED_STATE_ON_GROUND)
        )
        assert guard.says(mavlink.MAVLink_extended_sys_state_message(0, landed)).in_air is in_air

    in_time(check)


def test_a_position_that_stopped_keeps_its_own_time_while_the_vehicle_beats() -> None:
    async def main() -> None:
        guard = Link()
        position = mavlink.MAVLink_global_position_int_message(
            0, 474000000, 85000000, 481000, 1000, 0, 0, 0, 0
        )
        seen = guard.says(position)
        assert seen.position_ns == seen.heartbeat_ns
        await asyncio.sleep(3.0)
        later = guard.says(mavlink.MAVLink_heartbeat_message(2, 12, 129, 6 << 16, 4, 3))
        assert later.heartbeat_ns - later.position_ns == pytest.approx(3e9, abs=1e7)
        assert later.mode is FlightMode.OFFBOARD and later.armed

    run_virtual(main())
