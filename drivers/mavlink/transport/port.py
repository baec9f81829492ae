"""MAVLink packets over UDP or a serial port, without a library of threads: nothing here blocks or
waits.

Only messages of wanted ids are decoded. An autopilot's second port may carry a thousand others a
second.
"""

from __future__ import annotations

import contextlib
import os
import re
import socket
from collections.abc import Callable
from typing import Any, Protocol

import serial
from pymavlink.dialects.v20 import all as mavlink

from drivers.interfaces import VehicleError
from drivers.mavlink.transport.frames import AUTOPILOT, head_of, take_frames
from drivers.mavlink.transport.port_lock import PortLock
from drivers.mavlink.transport.signing import SignatureCheck, Signer
from drivers.mavlink.transport.source import Address, VehicleSource

_READ_AT_ONCE = 4096
_MOST_READS = 1000  # a flood does not keep the guard from its rules
URL = re.compile(r"(udpin|udpout|serial)://(.+):(\d+)")
UNSIGNED = "packets of the vehicle's number that are not signed with the key"


class Transport(Protocol):
    """``shared``: anybody can send to it, and what came in is whole datagrams with the address they
    came from.
    """

    shared: bool

    def fileno(self) -> int: ...

    def read(self) -> tuple[bytes, Address | None]:
        """Return what came in, and from where; empty when nothing waits."""
        ...

    def write(self, packet: bytes, to: Address | None) -> None:
        """``to``: where, on a shared one; None is nowhere there."""
        ...

    def close(self) -> None: ...


class UdpIn:
    """Listens; whoever it hears is no reason to answer."""

    shared = True

    def __init__(self, address: Address) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.bind(address)
        except OSError:
            self._socket.close()
            raise

    def fileno(self) -> int:
        return self._socket.fileno()

    def read(self) -> tuple[bytes, Address | None]:
        try:
            return self._socket.recvfrom(_READ_AT_ONCE)
        except OSError:
            return b"", None

    def write(self, packet: bytes, to: Address | None) -> None:
        if to is not None:
            with contextlib.suppress(OSError):
                self._socket.sendto(packet, to)

    def close(self) -> None:
        self._socket.close()


class UdpOut:
    """Talks to one address, and hears no other; a router or an autopilot answers where it was
    spoken to from.
    """

    shared = False

    def __init__(self, address: Address) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.connect(address)

    def fileno(self) -> int:
        return self._socket.fileno()

    def read(self) -> tuple[bytes, Address | None]:
        try:
            return self._socket.recv(_READ_AT_ONCE), None
        except OSError:
            return b"", None

    def write(self, packet: bytes, to: Address | None) -> None:
        del to
        with contextlib.suppress(OSError):
            self._socket.send(packet)

    def close(self) -> None:
        self._socket.close()


class SerialPort:
    """A second telemetry port of the autopilot."""

    shared = False

    def __init__(self, device: str, baud: int) -> None:
        self._port = serial.Serial(device, baud, timeout=0, write_timeout=0, exclusive=True)

    def fileno(self) -> int:
        return self._port.fileno()

    def read(self) -> tuple[bytes, Address | None]:
        try:
            return os.read(self._port.fileno(), _READ_AT_ONCE), None
        except OSError:  # nothing there, or unplugged: the age of what was heard tells
            return b"", None

    def write(self, packet: bytes, to: Address | None = None) -> None:
        del to
        with contextlib.suppress(OSError):
            os.write(self._port.fileno(), packet)

    def close(self) -> None:
        self._port.close()


class MavlinkPort:
    """One vehicle's messages of some kinds, and a way to send to it. Raises VehicleError when it
    cannot be opened.

    On a port that anybody can send to it is heard from one address, once that was proven, and
    answered there.
    """

    def __init__(
        self, url: str, sysid: int, own: tuple[int, int], wanted: frozenset[int], now_ns: Callable[[], int],
        key: bytes | None = None,
    ) -> None:  # fmt: skip
        """``own``: system and component id that are sent from; ``key``: of the signatures, both
        ways.
        """
        self._wanted = wanted
        self._now_ns = now_ns
        self._source = VehicleSource(sysid, own)
        self._waiting = bytearray()
        self._mav: Any = mavlink.MAVLink(None, srcSystem=own[0], srcComponent=own[1])
        self._check = None if key is None else SignatureCheck(key)
        self._signer = None if key is None else Signer(key, own[1], extras())
        self._lock = PortLock(url)
        try:
            self._transport = open_transport(url)
        except (OSError, serial.SerialException) as error:
            self._lock.release()
            raise VehicleError(
                f"the guard cannot open {url}: {error}", "check that the device or port is free"
            ) from error

    @property
    def ignored(self) -> dict[str, int]:
        """Numbers of messages that came as the vehicle's and were not believed, by why, in
        words.
        """
        return self._source.ignored

    def close(self) -> None:
        self._transport.close()
        self._lock.release()

    def read(self) -> list[Any]:
        """The wanted messages of the vehicle's autopilot that came in, in order."""
        messages: list[Any] = []
        for _ in range(_MOST_READS):
            data, source = self._transport.read()
            if not data:
                break
            if source is not None:
                # what another one left unfinished does not hide what comes next
                self._waiting.clear()
            self._waiting += data
            for frame in take_frames(self._waiting):
                message = (
                    self._decode(frame)
                    if self._is_ours(frame) and self._believes(frame, source)
                    else None
                )
                if message is not None:
                    messages.append(message)
        return messages

    def send(self, message: Any) -> None:
        packet = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        self._write(packet, self._source.pinned)

    def _write(self, packet: bytes, to: Address | None) -> None:
        signed = packet if self._signer is None else self._signer.sign(packet)
        if signed is not None:
            self._transport.write(signed, to)

    def _is_ours(self, frame: bytes) -> bool:
        head = head_of(frame)
        return (head.system, head.component) == (self._source.sysid, AUTOPILOT)

    def _believes(self, frame: bytes, source: Address | None) -> bool:
        if self._check is not None and not self._check.holds(frame):
            self._source.ignore(UNSIGNED)
            return False
        if source is None:
            return True
        now_ns = self._now_ns()
        if self._source.believes(frame, source, now_ns):
            return True
        question = self._source.question(frame, source, now_ns)
        if question is not None:
            self._write(question, source)
        return False

    def _decode(self, frame: bytes) -> Any | None:
        """None for what is not wanted, or damaged."""
        if head_of(frame).message not in self._wanted:
            return None
        try:
            return self._mav.decode(bytearray(frame))
        except mavlink.MAVError:
            return None


def extras() -> dict[int, int]:
    """The checksum's byte of every message there is."""
    return {message: kind.crc_extra for message, kind in mavlink.mavlink_map.items()}


def open_transport(url: str) -> Transport:
    match = URL.fullmatch(url)
    assert match is not None  # PortLock and the Config have read it
    kind = match[1]
    host = match[2]
    number = int(match[3])
    if kind == "serial":
        return SerialPort(host, number)
    return UdpIn((host, number)) if kind == "udpin" else UdpOut((host, number))
