"""A MAVLink 2 endpoint around a simulated drone, for an unmodified MAVSDK to connect to: a small
PX4 on loopback.

It has no thread and no clock: whoever steps the world calls ``pump`` at 200-250 Hz. In real time it
is told how arrivals count on the world's clock, and hears everything at the time it came, however
late the world gets to it.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Iterator
from operator import attrgetter
from typing import Any, NamedTuple

from pymavlink.dialects.v20 import common as mavlink

from drivers.interfaces import FlightMode
from drivers.link.key import signing_time
from drivers.mavlink.geodesy import LocalTangent
from hil.vehicle.answers import (
    NOT_FOLLOWED,
    OLDER_REQUESTS,
    STICKS,
    answer,
    is_meant,
    sticks_of,
)
from hil.vehicle.arrival import Address
from hil.vehicle.channel import UdpChannel
from hil.vehicle.commands import ACCEPTED, DENIED, NOT_NOW, Commands, whole
from hil.vehicle.messages import (
    AVAILABLE_MODES,
    STREAMS,
    FlightInstant,
    available_modes,
)
from hil.vehicle.parameters import Parameters
from hil.vehicle.setpoints import FRAMES, Setpoints
from hil.world.world import SimDrone
from path.messages import Vec3
from path.values import frozen

LARGEST_ID = 0xFFFF  # of a message, in MESSAGE_INTERVAL


@frozen
class MavlinkVehicleConfig:
    """The place of a vehicle on the wire.

    Attributes:
        sysid: its MAVLink system id.
        remote: where MAVSDK listens (``udpin``).
        bind: its own address; port 0 takes a free one.
        second: where a second ground station or companion listens, on a port of its own with
            streams of its own.
        ground: where a ground station for people listens, QGroundControl or MAVProxy; likewise.
        key: of MAVLink 2's signatures: it signs, and takes nothing that is not signed.
    """

    sysid: int
    remote: Address
    bind: Address = ("127.0.0.1", 0)
    second: Address | None = None
    ground: Address | None = None
    key: bytes | None = None


class _Packet(NamedTuple):
    """A packet that came in. ``at_s``: its instant by the world's clock."""

    at_s: float
    packet: bytes
    sender: Address
    channel: UdpChannel


_at_s = attrgetter("at_s")


class MavlinkVehicle:
    """One drone on the wire. Faults: while ``silent`` nothing is sent and whatever comes in is
    lost.

    Attributes:
        received: messages for this vehicle by type, counted.
        malformed: messages that could not be understood.
        tap: called with (now_s, message) for every message from anybody; for tests and logs.
    """

    def __init__(
        self,
        config: MavlinkVehicleConfig,
        drone: SimDrone,
        tangent: LocalTangent,
        arrived: Callable[[float], float] | None = None,
    ) -> None:
        """``arrived``: the world's time of an instant of the monotonic clock. None: what is read
        came just then.
        """
        self._config = config
        self._drone = drone
        self._tangent = tangent
        self._local_origin_n_m: Vec3 | None = None
        self._channels = [UdpChannel(config.bind, config.remote)]
        for further in (config.second, config.ground):
            if further is not None:
                self._channels.append(UdpChannel((config.bind[0], 0), further))
        self._mav: Any = mavlink.MAVLink(
            None, srcSystem=config.sysid, srcComponent=mavlink.MAV_COMP_ID_AUTOPILOT1
        )
        if config.key is not None:
            self._mav.signing.secret_key = config.key
            self._mav.signing.sign_outgoing = True
            self._mav.signing.timestamp = signing_time()
        self._parameters = Parameters(drone.autopilot)
        self._shown: tuple[FlightMode, bool] | None = None
        self._texts_sent = 0
        self._commands = Commands(self._parameters, tangent)
        self._setpoints = Setpoints()
        self._refused_s = -math.inf
        beat_hz = drone.autopilot.config.heartbeat_hz
        self._own_beat_s = 1.0 / beat_hz if beat_hz > 0.0 else None
        for channel in self._channels:
            channel.beat_every(self._own_beat_s)
        self._arrived = arrived
        # came after the newest time that the world has been stepped to
        self._waiting: list[_Packet] = []
        self._heard_s = 0.0
        if arrived is not None:
            drone.hears = self.hear
        self.silent = False
        self.received: Counter[str] = Counter()
        self.malformed = 0
        self.tap: Callable[[float, Any], None] | None = None

    @property
    def address(self) -> Address:
        """The address at which it listens itself, for a second ground station."""
        return self._channels[0].address

    def close(self) -> None:
        self._drone.hears = None
        for channel in self._channels:
            channel.close()

    def pump(self, now_s: float) -> None:
        """Take what came in, act on it, send what is due. ``now_s`` is the time the drone was
        stepped to.
        """
        self.hear(now_s)
        if not self.silent:
            flight = self._flight(now_s)
            self._send_texts(flight)
            self._send_due(flight)

    def hear(self, now_s: float) -> None:
        """Take what came in until ``now_s``, in the order and at the times in which it came, and
        act on it.
        """
        for channel in self._channels:
            for packet, sender, arrival_s in channel.packets():
                at_s = now_s if self._arrived is None else self._arrived(arrival_s)
                self._waiting.append(_Packet(max(at_s, self._heard_s), packet, sender, channel))
        self._heard_s = max(self._heard_s, now_s)
        if self._waiting:
            self._waiting.sort(key=_at_s)
            came = bisect_right(self._waiting, now_s, key=_at_s)
            heard = self._waiting[:came]
            self._waiting = self._waiting[came:]
            for each in heard:
                self._receive(self._flight(each.at_s), each)

    def _flight(self, at_s: float) -> FlightInstant:
        drone = self._drone
        if self._local_origin_n_m is None:
            self._local_origin_n_m = drone.estimate.position_n_m
        return FlightInstant(
            at_s,
            drone.autopilot,
            drone.estimate,
            self._tangent,
            self._local_origin_n_m,
            drone.rangefinder,
        )

    # --- out ---

    def send_raw(self, packet: bytes) -> None:
        """A packet from the vehicle's own address that is not its own, as a forger would send
        it.
        """
        self._channels[0].send(packet)

    def _send(self, channel: UdpChannel, message: Any, to: Address | None = None) -> None:
        channel.send(self._packed(message), to)

    def _packed(self, message: Any) -> bytes:
        packet: bytes = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        return packet

    def _send_texts(self, flight: FlightInstant) -> None:
        texts = flight.autopilot.status_texts
        while self._texts_sent < len(texts):
            text = texts[self._texts_sent]
            self._texts_sent += 1
            for channel in self._channels:
                message = mavlink.MAVLink_statustext_message(
                    text.severity.value, text.text.encode()[:50]
                )
                self._send(channel, message)

    def _send_due(self, flight: FlightInstant) -> None:
        shown = flight.autopilot.mode, flight.autopilot.armed
        changed = shown != self._shown and self._own_beat_s is None  # a change is told at once
        self._shown = shown
        packets: dict[int, bytes] = {}  # of this instant: every channel is told the same
        for channel in self._channels:
            if changed:
                channel.heartbeat_now()
            # By the estimate's time and not by ours: a stream as fast as the estimator then carries
            # every estimate once, at once, instead of beating against it with up to a period of
            # delay.
            due = list(channel.due(flight.estimate.time_s))
            for message in due:
                if message not in packets and (made := STREAMS[message][0](flight)) is not None:
                    packets[message] = self._packed(made)
            # In one datagram, as PX4 sends them: each one sent gives the interpreter away, and what
            # draws takes it.
            if together := b"".join(packets.get(message, b"") for message in due):
                channel.send(together)

    def _send_message(self, flight: FlightInstant, channel: UdpChannel, message: int) -> None:
        made = STREAMS[message][0](flight)
        if made is not None:
            self._send(channel, made)

    # --- in ---

    def _receive(self, flight: FlightInstant, came: _Packet) -> None:
        for frame in _frames(came.packet) if not self.silent else ():
            message = self._decode(frame)
            if message is None:
                self.malformed += 1
            else:
                self._take(flight, message, came.channel, came.sender)

    def _decode(self, frame: bytearray) -> Any | None:
        """None for what is damaged or of an unknown id: then pymavlink has checked no CRC."""
        try:
            message = self._mav.decode(frame)
        except mavlink.MAVError:
            return None
        return message if message.get_msgId() in mavlink.mavlink_map else None

    def _take(
        self, flight: FlightInstant, message: Any, channel: UdpChannel, sender: Address
    ) -> None:
        if self.tap is not None:
            self.tap(flight.now_s, message)
        if not is_meant(message, self._config.sysid):
            return
        kind = message.get_type()
        self.received[kind] += 1
        if kind == "SET_POSITION_TARGET_LOCAL_NED":
            self._setpoint(flight, message)
        elif kind in ("COMMAND_LONG", "COMMAND_INT"):
            self._command(flight, message, channel, sender)
        elif kind == "HEARTBEAT" and message.type == mavlink.MAV_TYPE_GCS:
            flight.autopilot.companion_heard(flight.now_s)
        elif kind == "TIMESYNC" and message.tc1 == 0:
            self._send(
                channel,
                mavlink.MAVLink_timesync_message(round(flight.now_s * 1e9) + 1, message.ts1),
                sender,
            )
        elif kind in STICKS:
            flight.autopilot.radio.override(flight.now_s, sticks_of(message))
        elif kind == "SET_MODE":
            self._set_old_mode(flight, message, channel, sender)
        elif kind in NOT_FOLLOWED:
            self._refuse_setpoint(flight, kind)
        elif kind.startswith("PARAM_"):
            for value in self._parameters.answer(message, flight.now_s):
                self._send(channel, value, sender)
        elif (said := answer(message)) is not None:
            self._send(channel, said, sender)

    def _setpoint(self, flight: FlightInstant, message: Any) -> None:
        """Follow a setpoint; of one in a frame that is not followed a status text says so."""
        frame = message.coordinate_frame
        if frame not in FRAMES:
            self._refuse_setpoint(flight, f"SET_POSITION_TARGET_LOCAL_NED frame {frame}")
            return
        wanted = self._setpoints.read(flight, message)
        if wanted is not None and not flight.autopilot.setpoint(flight.now_s, wanted):
            self.malformed += 1

    def _refuse_setpoint(self, flight: FlightInstant, what: str) -> None:
        """Say once a second that such setpoints are not followed: they have no answer of their
        own.
        """
        if flight.now_s - self._refused_s < 1.0:
            return
        self._refused_s = flight.now_s
        text = f"{what} unsupported".encode()[:50]
        for channel in self._channels:
            self._send(
                channel, mavlink.MAVLink_statustext_message(mavlink.MAV_SEVERITY_CRITICAL, text)
            )

    def _command(
        self, flight: FlightInstant, message: Any, channel: UdpChannel, sender: Address
    ) -> None:
        command = message.command
        after: int | None = None
        if command == mavlink.MAV_CMD_REQUEST_MESSAGE and message.param1 == AVAILABLE_MODES:
            modes = available_modes(whole(message.param2) or 0)
            result = ACCEPTED if modes else DENIED
            self._acknowledge(channel, message, command, result, sender)
            for mode in modes:
                self._send(channel, mode, sender)
            return
        if command == mavlink.MAV_CMD_REQUEST_MESSAGE or command in OLDER_REQUESTS:
            after = OLDER_REQUESTS.get(command, whole(message.param1))
            result = DENIED if after not in STREAMS else ACCEPTED
        elif command == mavlink.MAV_CMD_GET_MESSAGE_INTERVAL:
            result = self._tell_interval(channel, message, sender)
        elif command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
            result = self._set_interval(flight, channel, message)
        else:
            result = self._commands.obey(flight, message)
        if after is not None and result == ACCEPTED and STREAMS[after][0](flight) is None:
            result = NOT_NOW
        self._acknowledge(channel, message, command, result, sender)
        if after is not None and result == ACCEPTED:
            self._send_message(flight, channel, after)

    def _acknowledge(
        self, channel: UdpChannel, message: Any, command: int, result: int, sender: Address
    ) -> None:
        to = message.get_srcSystem(), message.get_srcComponent()
        self._send(
            channel, mavlink.MAVLink_command_ack_message(command, result, 255, 0, *to), sender
        )

    def _set_interval(self, flight: FlightInstant, channel: UdpChannel, message: Any) -> int:
        which = whole(message.param1)
        interval_us = whole(message.param2)
        if which is None or interval_us is None:
            return DENIED
        if which == mavlink.MAVLINK_MSG_ID_HEARTBEAT and self._own_beat_s is not None:
            return ACCEPTED  # and goes on as it did
        return (
            ACCEPTED if channel.set_interval(which, interval_us, flight.estimate.time_s) else DENIED
        )

    def _tell_interval(self, channel: UdpChannel, message: Any, sender: Address) -> int:
        which = whole(message.param1)
        if which is None or not 0 <= which <= LARGEST_ID:
            return DENIED
        interval_us = channel.interval_us(which)
        self._send(channel, mavlink.MAVLink_message_interval_message(which, interval_us), sender)
        return ACCEPTED

    def _set_old_mode(
        self, flight: FlightInstant, message: Any, channel: UdpChannel, sender: Address
    ) -> None:
        """SET_MODE, which DO_SET_MODE has followed: PX4 takes it, and answers as if it had been
        that command.
        """
        result = self._commands.select(
            flight, message.custom_mode >> 16 & 0xFF, message.custom_mode >> 24 & 0xFF
        )
        self._acknowledge(channel, message, mavlink.MAV_CMD_DO_SET_MODE, result, sender)


def _frames(packet: bytes) -> Iterator[bytearray]:
    """The messages of one datagram. Unlike a byte stream's, its damaged end must not wait for the
    next one.
    """
    rest = bytearray(packet)
    while rest:
        overhead = 12 if rest[0] == mavlink.PROTOCOL_MARKER_V2 else 8
        signed = overhead == 12 and len(rest) > 2 and bool(rest[2] & mavlink.MAVLINK_IFLAG_SIGNED)
        size = (
            overhead
            + (rest[1] if len(rest) > 1 else 0)
            + (mavlink.MAVLINK_SIGNATURE_BLOCK_LEN if signed else 0)
        )
        yield rest[:size]
        rest = rest[size:]
