"""Between a real autopilot and its companion: passes every packet on, and sees what the harness
must know of it.

It stands for the cable: a fault can cut it. What it sees (armed, mode, how long the vehicle went
without a setpoint) comes from the packets themselves and from nobody's report.
"""

from __future__ import annotations

import contextlib
import math
import socket
from collections.abc import Callable, Iterator
from operator import itemgetter
from typing import Any

from pymavlink.dialects.v20 import all as mavlink

from drivers.interfaces import FlightMode
from drivers.mavlink.modes import (
    ARDUPILOT,
    CUSTOM_MODE_ENABLED,
    KINDS,
    PX4,
    SAFETY_ARMED,
    AutopilotKind,
)
from hil.autopilot.values import OffboardSession
from hil.vehicle.arrival import Address, bound, packets

_arrival_s = itemgetter(2)

PILOT_SYSID = 251  # a second ground station
AUTOPILOT = 1
V2_OVERHEAD = 12
V2_SIGNATURE = 13
V1_OVERHEAD = 8

HEARTBEAT = 0
COMMAND_LONG = 76
SET_POSITION_TARGET = 84
CURRENT_MODE = 436
DO_SET_MODE = 176
NAV_LAND = 21
NAV_RETURN = 20
# What a second ground station selects: LOITER; HOLD on a PX4, which refuses modes that need sticks
# while it has none.
PILOT_MODE = {PX4.name: (4.0, 3.0), ARDUPILOT.name: (5.0, 0.0)}


class FlightWatch:
    """Armed, mode and offboard sessions of one vehicle. Times are seconds of the world's clock.

    A session begins with the first setpoint that arrives while the mode is OFFBOARD: ArduPilot
    climbs in that mode without any. It ends with the command that leaves the mode, or when the
    vehicle says that it is in another: with its heartbeat, or with CURRENT_MODE where it is asked
    for that, as PX4 beats once a second. To a vehicle whose motors its pilot has stopped nobody
    owes a setpoint: a PX4 calls itself armed, and in OFFBOARD, for 5 s more.
    """

    def __init__(self, kind: AutopilotKind) -> None:
        self._kind = kind
        self.armed = False
        self.mode = FlightMode.OTHER
        self.offboard_sessions: list[OffboardSession] = []
        self.newest_setpoint_s = -math.inf
        self._leaving = False
        self._stopped = False

    @property
    def setpoint_gap_s(self) -> float:
        """Longest time between setpoints in any session so far."""
        return max((session.max_gap_s for session in self.offboard_sessions), default=0.0)

    def on_heartbeat(
        self,
        now_s: float,
        custom_mode: int,
        base_mode: int,
    ) -> None:
        self.armed = bool(base_mode & SAFETY_ARMED)
        self.on_mode(now_s, custom_mode)
        if not self.armed:
            self._stopped = False
            self._end(now_s, self.mode)

    def on_kill_switch(self, now_s: float) -> None:
        """The pilot's is thrown; may be said again."""
        self._stopped = self.armed
        self._end(now_s, self.mode)

    def on_mode(self, now_s: float, custom_mode: int) -> None:
        self.mode = self._kind.mode(custom_mode)
        if self.mode is not FlightMode.OFFBOARD:
            self._leaving = False
            self._end(now_s, self.mode)

    def on_setpoint(self, now_s: float) -> None:
        session = self._open
        if session is not None:
            session.note_gap(self.newest_setpoint_s, now_s)
        elif (
            self.armed and self.mode is FlightMode.OFFBOARD and not (self._leaving or self._stopped)
        ):
            self.offboard_sessions.append(OffboardSession(now_s))
        self.newest_setpoint_s = now_s

    def on_command(
        self,
        now_s: float,
        command: int,
        param2: float,
    ) -> None:
        """A command from the companion: leaving OFFBOARD by its own will is no gap."""
        offboard = self._kind.set_mode[FlightMode.OFFBOARD][0]
        if command in (NAV_LAND, NAV_RETURN) or (command == DO_SET_MODE and param2 != offboard):
            self._end(now_s, FlightMode.HOLD)
            self._leaving = True
        elif command == DO_SET_MODE:
            self._leaving = False

    @property
    def _open(self) -> OffboardSession | None:
        last = self.offboard_sessions[-1] if self.offboard_sessions else None
        return last if last is not None and last.end_s is None else None

    def _end(self, now_s: float, mode: FlightMode) -> None:
        session = self._open
        if session is not None:
            session.note_gap(self.newest_setpoint_s, now_s)
            session.end_s = now_s
            session.ended_by = mode


class MavlinkRelay:
    """Two UDP sockets back to back. While ``silent`` the cable is cut, both ways.

    ``tap`` is called with id, bytes and arrival (monotonic clock) of each message of the vehicle,
    the cable cut or not.
    """

    def __init__(
        self,
        kind: str,
        sysid: int,
        vehicle: Address,
        companion: Address,
    ) -> None:
        """``vehicle``: where the autopilot sends to; ``companion``: where MAVSDK listens. Raises
        OSError.
        """
        self._sysid = sysid
        self._kind = next(known for known in KINDS if known.name == kind)
        self.watch = FlightWatch(self._kind)
        self.silent = False
        self.tap: Callable[[int, bytes, float], None] | None = None
        self._companion = companion
        self._peer: Address | None = None
        self._mav: Any = mavlink.MAVLink(None, srcSystem=PILOT_SYSID, srcComponent=190)
        self._vehicle_socket = bound(vehicle)
        try:
            self._companion_socket = bound(("127.0.0.1", 0))
        except OSError:
            self._vehicle_socket.close()
            raise

    @property
    def sockets(self) -> tuple[socket.socket, socket.socket]:
        return self._vehicle_socket, self._companion_socket

    def close(self) -> None:
        for each in self.sockets:
            each.close()

    def receive(self, epoch_s: float) -> None:
        """Pass on all that came in on either side, in the order in which it came.

        ``epoch_s``: zero of the world's clock, on the monotonic one.
        """
        came = [(*each, self._from_vehicle) for each in packets(self._vehicle_socket)]
        came += [(*each, self._from_companion) for each in packets(self._companion_socket)]
        for packet, sender, arrival_s, take in sorted(came, key=_arrival_s):
            take(packet, sender, arrival_s, epoch_s)

    def pilot_takes_over(self) -> None:
        """A second ground station changes the mode, as a pilot's switch does."""
        self.order(DO_SET_MODE, float(CUSTOM_MODE_ENABLED), *PILOT_MODE[self._kind.name])

    def order(self, command: int, *params: float) -> None:
        """A command of that second ground station, sent once."""
        filled = [*params, *([0.0] * (7 - len(params)))]
        self._send_own(
            mavlink.MAVLink_command_long_message(self._sysid, AUTOPILOT, command, 0, *filled)
        )

    def _from_vehicle(
        self,
        packet: bytes,
        sender: Address,
        arrival_s: float,
        epoch_s: float,
    ) -> None:
        self._peer = sender
        for message_id, sysid, frame in frames(packet):
            if message_id in (HEARTBEAT, CURRENT_MODE) and sysid == self._sysid:
                self._on_vehicle(frame, arrival_s - epoch_s)
            if self.tap is not None and sysid == self._sysid:
                self.tap(message_id, frame, arrival_s)
        if not self.silent:
            _send(self._companion_socket, packet, self._companion)

    def _from_companion(
        self,
        packet: bytes,
        _: Address,
        arrival_s: float,
        epoch_s: float,
    ) -> None:
        if self.silent or self._peer is None:
            return
        for message_id, _sysid, frame in frames(packet):
            if message_id == SET_POSITION_TARGET:
                self.watch.on_setpoint(arrival_s - epoch_s)
            elif message_id == COMMAND_LONG:
                self._on_command(frame, arrival_s - epoch_s)
        _send(self._vehicle_socket, packet, self._peer)

    def _send_own(self, message: Any) -> None:
        if self._peer is not None:
            _send(self._vehicle_socket, message.pack(self._mav), self._peer)
            self._mav.seq = (self._mav.seq + 1) % 256

    def _on_vehicle(self, frame: bytes, now_s: float) -> None:
        message = self._decoded(frame)
        if message is None or message.get_srcComponent() != AUTOPILOT:
            return
        if message.get_msgId() == HEARTBEAT:
            self.watch.on_heartbeat(now_s, message.custom_mode, message.base_mode)
        else:
            self.watch.on_mode(now_s, message.custom_mode)

    def _on_command(self, frame: bytes, now_s: float) -> None:
        command = self._decoded(frame)
        if command is not None:
            self.watch.on_command(now_s, command.command, command.param2)

    def _decoded(self, frame: bytes) -> Any | None:
        try:
            return self._mav.decode(bytearray(frame))
        except mavlink.MAVError:
            return None


def _send(
    through: socket.socket,
    packet: bytes,
    to: Address,
) -> None:
    with contextlib.suppress(OSError):
        through.sendto(packet, to)


def frames(packet: bytes) -> Iterator[tuple[int, int, bytes]]:
    """(message id, system id, bytes) of every MAVLink message of a datagram; PX4 puts many into
    one.
    """
    at = 0
    while at + V1_OVERHEAD <= len(packet):
        if packet[at] == mavlink.PROTOCOL_MARKER_V2 and at + V2_OVERHEAD <= len(packet):
            signed = V2_SIGNATURE if packet[at + 2] & mavlink.MAVLINK_IFLAG_SIGNED else 0
            size = V2_OVERHEAD + packet[at + 1] + signed
            yield (
                int.from_bytes(packet[at + 7 : at + 10], "little"),
                packet[at + 5],
                packet[at : at + size],
            )
        elif packet[at] == mavlink.PROTOCOL_MARKER_V1:
            size = V1_OVERHEAD + packet[at + 1]
            yield packet[at + 5], packet[at + 3], packet[at : at + size]
        else:
            return
        at += size
