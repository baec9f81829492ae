"""The wires of the harness's connection to a simulation: UDP to a program, a serial port to a
flight controller.
"""

from __future__ import annotations

import contextlib
import re
import time
from collections.abc import Iterator
from typing import Protocol

import serial

from drivers.interfaces import PartError
from drivers.mavlink.transport.frames import take_frames
from drivers.mavlink.transport.port import SerialPort
from hil.vehicle.arrival import Address, bound, packets
from hil.vehicle.simulators.relay import frames

Message = tuple[int, int, bytes, float]  # id, system id, bytes, arrival on the monotonic clock
SERIAL = re.compile(r"serial://(.+):(\d+)")


class Wire(Protocol):
    def fileno(self) -> int: ...

    def close(self) -> None: ...

    def read(self) -> Iterator[Message]:
        """All messages that came in."""
        ...

    def write(self, packet: bytes) -> None:
        """Sent once, or lost when nobody is there."""
        ...

    @property
    def met(self) -> bool:
        """Return whether there is somebody to write to."""
        ...


class UdpWire:
    """Bound to a port the simulator sends to; it is answered where it was heard from last."""

    def __init__(self, port: Address) -> None:
        """Raise OSError when the port is taken."""
        self._socket = bound(port)
        self._peer: Address | None = None

    @property
    def address(self) -> Address:
        return self._socket.getsockname()

    @property
    def met(self) -> bool:
        return self._peer is not None

    def fileno(self) -> int:
        return self._socket.fileno()

    def close(self) -> None:
        self._socket.close()

    def read(self) -> Iterator[Message]:
        for packet, sender, arrival_s in packets(self._socket):
            self._peer = sender
            for message_id, sysid, frame in frames(packet):
                yield message_id, sysid, frame, arrival_s

    def write(self, packet: bytes) -> None:
        if self._peer is not None:
            with contextlib.suppress(OSError):
                self._socket.sendto(packet, self._peer)


class SerialWire:
    """A MAVLink port of a flight controller. Nothing stamps what comes in but the reader: it may
    come to it late.
    """

    met = True

    def __init__(self, url: str) -> None:
        """``serial:///dev/ttyACM1:921600``. Raises PartError when it cannot be opened."""
        match = SERIAL.fullmatch(url)
        if match is None:
            raise PartError(
                f"{url} is no serial port", "write it like serial:///dev/ttyACM1:921600"
            )
        try:
            self._port = SerialPort(match[1], int(match[2]))
        except (OSError, serial.SerialException) as error:
            raise PartError(
                f"cannot open {url}: {error}", "is the board plugged in, and the device free?"
            ) from error
        self._waiting = bytearray()

    def fileno(self) -> int:
        return self._port.fileno()

    def close(self) -> None:
        self._port.close()

    def read(self) -> Iterator[Message]:
        while data := self._port.read()[0]:
            arrival_s = time.monotonic()
            self._waiting += data
            for frame in take_frames(self._waiting):
                for message_id, sysid, whole in frames(frame):
                    yield message_id, sysid, whole, arrival_s

    def write(self, packet: bytes) -> None:
        self._port.write(packet)


def open_wire(port: Address | str) -> Wire:
    """Raise OSError or PartError when it is not to be had."""
    return SerialWire(port) if isinstance(port, str) else UdpWire(port)
