"""MAVLink packets over UDP or a serial port, without a library of threads: nothing here blocks or waits.

Only messages of wanted ids are decoded. An autopilot's second port may carry a thousand others a second.
"""

from __future__ import annotations

import contextlib
import os
import re
import socket
from collections.abc import Iterator
from typing import Any, Protocol

import serial
from pymavlink.dialects.v20 import all as mavlink

from drivers.interfaces import VehicleError
from drivers.link.udp import Address
from drivers.mavlink.port_lock import PortLock

V1, V2 = 0xFE, 0xFD
_V1_OVERHEAD, _V2_OVERHEAD, _SIGNATURE = 8, 12, 13
_SIGNED = 0x01
_READ_AT_ONCE = 4096
_MOST_READS = 1000  # a flood does not keep the guard from its rules
URL = re.compile(r"(udpin|udpout|serial)://(.+):(\d+)")


class Transport(Protocol):
    def read(self) -> bytes:
        """What came in; empty when nothing waits."""
        ...

    def write(self, packet: bytes) -> None: ...

    def heard(self) -> None:
        """What was read last came from the vehicle."""
        ...

    def close(self) -> None: ...


class UdpIn:
    """Listens; answers go to where the vehicle was heard from last."""

    def __init__(self, address: Address) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._last: Address | None = None
        self._vehicle: Address | None = None
        try:
            self._socket.bind(address)
        except OSError:
            self._socket.close()
            raise

    def read(self) -> bytes:
        try:
            data, self._last = self._socket.recvfrom(_READ_AT_ONCE)
        except OSError:
            return b""
        return data

    def heard(self) -> None:
        self._vehicle = self._last

    def write(self, packet: bytes) -> None:
        if self._vehicle is not None:
            with contextlib.suppress(OSError):
                self._socket.sendto(packet, self._vehicle)

    def close(self) -> None:
        self._socket.close()


class UdpOut:
    """Talks to one address; a router or an autopilot answers where it was spoken to from."""

    def __init__(self, address: Address) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.connect(address)

    def read(self) -> bytes:
        try:
            return self._socket.recv(_READ_AT_ONCE)
        except OSError:
            return b""

    def heard(self) -> None: ...

    def write(self, packet: bytes) -> None:
        with contextlib.suppress(OSError):
            self._socket.send(packet)

    def close(self) -> None:
        self._socket.close()


class SerialPort:
    """A second telemetry port of the autopilot."""

    def __init__(self, device: str, baud: int) -> None:
        self._port = serial.Serial(device, baud, timeout=0, write_timeout=0, exclusive=True)

    def fileno(self) -> int:
        return self._port.fileno()

    def read(self) -> bytes:
        try:
            return os.read(self._port.fileno(), _READ_AT_ONCE)
        except OSError:  # nothing there, or unplugged: the age of what was heard tells
            return b""

    def heard(self) -> None: ...

    def write(self, packet: bytes) -> None:
        with contextlib.suppress(OSError):
            os.write(self._port.fileno(), packet)

    def close(self) -> None:
        self._port.close()


class MavlinkPort:
    """One vehicle's messages of some kinds, and a way to send to it. Raises VehicleError when it cannot be opened."""

    def __init__(self, url: str, sysid: int, own: tuple[int, int], wanted: frozenset[int]) -> None:
        """``own``: system and component id that are sent from."""
        self._sysid, self._wanted = sysid, wanted
        self._waiting = bytearray()
        self._mav: Any = mavlink.MAVLink(None, srcSystem=own[0], srcComponent=own[1])
        self._lock = PortLock(url)
        try:
            self._transport = _open(url)
        except (OSError, serial.SerialException) as error:
            self._lock.release()
            raise VehicleError(
                f"the guard cannot open {url}: {error}", "check that the device or port is free"
            ) from error

    def close(self) -> None:
        self._transport.close()
        self._lock.release()

    def read(self) -> list[Any]:
        """The wanted messages of the vehicle's autopilot that came in, in order."""
        messages: list[Any] = []
        for _ in range(_MOST_READS):
            data = self._transport.read()
            if not data:
                break
            self._waiting += data
            for frame in take_frames(self._waiting):
                message = self._decode(frame)
                if message is not None:
                    self._transport.heard()
                    messages.append(message)
        return messages

    def send(self, message: Any) -> None:
        packet = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        self._transport.write(packet)

    def _decode(self, frame: bytearray) -> Any | None:
        """None for what is not wanted, damaged, or another's."""
        if frame[0] == V2:
            source, component, message_id = frame[5], frame[6], int.from_bytes(frame[7:10], "little")
        else:
            source, component, message_id = frame[3], frame[4], frame[5]
        if (source, component) != (self._sysid, mavlink.MAV_COMP_ID_AUTOPILOT1) or message_id not in self._wanted:
            return None
        try:
            return self._mav.decode(frame)
        except mavlink.MAVError:
            return None


def take_frames(waiting: bytearray) -> Iterator[bytearray]:
    """Cut whole frames off the front of a stream of bytes; what is no frame is skipped.

    A damaged frame may hide the next one for once: the checksum is for whoever decodes it, and telemetry comes again.
    """
    while waiting:
        if waiting[0] not in (V1, V2):
            begin = min((at for at in (waiting.find(V1), waiting.find(V2)) if at >= 0), default=len(waiting))
            del waiting[:begin]
            continue
        if len(waiting) < 3:
            return
        length = waiting[1] + _V1_OVERHEAD
        if waiting[0] == V2:
            length = waiting[1] + _V2_OVERHEAD + (_SIGNATURE if waiting[2] & _SIGNED else 0)
        if len(waiting) < length:
            return
        frame = waiting[:length]
        del waiting[:length]
        yield frame


def _open(url: str) -> Transport:
    match = URL.fullmatch(url)
    assert match is not None  # PortLock and the Config have read it
    kind, host, number = match[1], match[2], int(match[3])
    if kind == "serial":
        return SerialPort(host, number)
    return UdpIn((host, number)) if kind == "udpin" else UdpOut((host, number))
