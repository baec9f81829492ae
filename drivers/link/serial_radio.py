"""The link between the drones over a pair of serial radios: the same signed packets, one after the
other.
"""

from __future__ import annotations

import asyncio
import os
import termios
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Self

import serial

from drivers.interfaces import LinkCounters, LinkError, Received
from drivers.link.end import LinkContext, LinkEnd, Waiting, count
from drivers.link.framing import PacketFramer
from drivers.link.key import key_finding, signing_key, signing_time
from drivers.link.wire import Codec, longest
from drivers.rig.part_check import Finding
from path.bounds import Bounds, check_bounds
from path.messages import Message
from path.values import frozen

BITS_PER_BYTE = 10.0  # a start bit, eight, a stop bit
AHEAD_S = 0.02  # of bytes given to the port before they can have left it: more would be latency
MAX_WAITING = 16
READ_AT_ONCE = 4096
USUAL_BAUD = (19_200, 38_400, 57_600, 115_200, 230_400, 460_800, 921_600)
REOPEN_S = 0.5


@frozen
class SerialLinkConfig:
    """
    Attributes:
        port: such as ``/dev/serial/by-id/usb-...``, which stays the same when it is plugged in
            again.
        baud: of the port and the radio. Both drones' messages have to fit: some 7 kB/s at 50
            frames a second.
        key_file: 32 bytes, mode 0600; the same on both drones.
        allow_unsigned: fly without a key. Anyone with such a radio can then speak.
    """

    port: str
    baud: Annotated[int, Bounds(9600, 4_000_000, "baud")] = 115_200
    key_file: Path | None = None
    allow_unsigned: bool = False

    def __post_init__(self) -> None:
        check_bounds(self)
        if self.key_file is None and not self.allow_unsigned:
            raise ValueError(
                "key_file: a radio can be heard by anyone, so it needs a key (or allow_unsigned = true)"
            )

    def shortfall(self, rates_hz: Mapping[type[Message], float]) -> str | None:
        """Return what is wrong with its rate for so many messages of both drones a second, which
        take turns in the air; None where it carries them.
        """
        needed = BITS_PER_BYTE * sum(rate * longest(kind) for kind, rate in rates_hz.items())
        if self.baud >= needed:
            return None
        enough = next((baud for baud in USUAL_BAUD if baud >= needed), USUAL_BAUD[-1])
        return f"baud: {self.baud} is less than the {needed:.0f} that both drones' messages take; {enough} would do"


class SerialLink:
    """Implements ``drivers.interfaces.Link``.

    What is to be sent waits here and not in the port, at most ``MAX_WAITING`` words of the
    hand-over and the newest of each stream, so that a slow radio carries the present. A port that
    vanishes is silence, and is opened again when it is back.
    """

    Config = SerialLinkConfig

    def __init__(self, config: SerialLinkConfig, context: LinkContext) -> None:
        self._config = config
        self._clock = context.clock
        self._role = context.role
        self._end, self._waiting = self._new_end(None)
        self._end.inbox.close()
        self._framer = PacketFramer()
        self._port: serial.Serial | None = None
        self._open = False
        self._left = b""  # of a packet that the port did not take whole
        self._free_s = 0.0  # when the bytes given to the port have left it
        self._timer: asyncio.TimerHandle | None = None

    @property
    def counters(self) -> LinkCounters:
        return self._end.counters

    async def __aenter__(self) -> Self:
        """Raise LinkError for a key that cannot be used and for a port that cannot be opened."""
        key = signing_key(self._config.key_file)
        self._open_port()
        self._end, self._waiting = self._new_end(key)
        self._open = True
        return self

    async def __aexit__(self, *_: object) -> None:
        self._open = False
        self._end.inbox.close()
        self._close_port()

    async def examine(self) -> Sequence[Finding]:
        return (key_finding(self._config.key_file),)

    def send(self, message: Message) -> None:
        """Now, or as soon as the radio has room; a stream's message waits until a newer one takes
        its place.
        """
        if not self._open:
            raise LinkError("the link is not open", "enter it with `async with` first")
        if self._port is None:
            count(self.counters, "port_lost")
            return
        self._waiting.put(type(message), message)
        if self._timer is None:
            self._write()

    async def receive(self) -> Received:
        return await self._end.inbox.get()

    def _new_end(self, key: bytes | None) -> tuple[LinkEnd, Waiting[Message]]:
        end = LinkEnd(Codec(self._role, key, stamp=signing_time), 0)
        return end, Waiting(end.counters, MAX_WAITING, "superseded_unsent", "outbox_full")

    def _open_port(self) -> None:
        config = self._config
        try:
            port = serial.Serial(
                config.port,
                config.baud,
                timeout=0,
                write_timeout=0,
                exclusive=True,
            )
        except (serial.SerialException, termios.error, ValueError, OSError) as error:
            raise LinkError(
                f"serial port {config.port}: {error}",
                "is the radio plugged in, the name right, and this user in the group of the port (dialout)?",
            ) from error
        os.set_blocking(port.fileno(), False)
        self._port = port
        self._framer = PacketFramer()
        self._left = b""
        asyncio.get_running_loop().add_reader(port.fileno(), self._readable)

    def _close_port(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if self._port is not None:
            asyncio.get_running_loop().remove_reader(self._port.fileno())
            self._port.close()
            self._port = None

    def _readable(self) -> None:
        """Called by the loop; never raises."""
        assert self._port is not None
        arrival_ns = self._clock.now_ns()
        try:
            data = os.read(self._port.fileno(), READ_AT_ONCE)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:  # unplugged
            self._lost()
            return
        skipped = self._framer.skipped
        for packet in self._framer.feed(data):
            self._end.arrived(packet, arrival_ns)
        if self._framer.skipped > skipped:
            count(self.counters, "noise")

    def _write(self) -> None:
        """Give the port what it has room for; come again when it has more."""
        self._timer = None
        loop = asyncio.get_running_loop()
        while self._port is not None and (self._left or self._waiting):
            wait_s = self._free_s - loop.time() - AHEAD_S
            if wait_s > 0.0:
                self._timer = loop.call_later(wait_s, self._write)
                return
            data = self._left or self._next_packet()
            if not data:
                continue
            try:
                written = os.write(self._port.fileno(), data)
            except BlockingIOError:
                written = 0
            except OSError:
                self._lost()
                return
            self._left = data[written:]
            self._free_s = (
                max(self._free_s, loop.time()) + max(written, 1) * BITS_PER_BYTE / self._config.baud
            )
            if written == 0:  # flow control holds it back
                self._free_s = max(self._free_s, loop.time() + 2.0 * AHEAD_S)

    def _next_packet(self) -> bytes:
        """Signed only now, so that stamps are in the order of the air. Empty for what cannot be
        encoded.
        """
        return self._end.pack(self._waiting.pop()) or b""

    def _lost(self) -> None:
        """Close the port and drop what waits: it would be old when the port is back."""
        self._waiting.clear()
        self._close_port()
        self._timer = asyncio.get_running_loop().call_later(REOPEN_S, self._reopen)

    def _reopen(self) -> None:
        self._timer = None
        try:
            self._open_port()
        except LinkError:
            self._timer = asyncio.get_running_loop().call_later(REOPEN_S, self._reopen)
