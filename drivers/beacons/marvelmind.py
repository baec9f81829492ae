"""Marvelmind's ultrasonic beacons over serial ports, behind the Beacons Protocol."""

from __future__ import annotations

import asyncio
import os
import termios
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Self

import serial

from drivers.beacons.stream import MarvelmindStream, PortState
from drivers.interfaces import BeaconError, BeaconFix, Clock
from drivers.rig.part_check import Finding
from drivers.rig.parts import PartContext
from path.bounds import Bounds, check_bounds
from path.values import frozen

READ_AT_ONCE = 4096
REOPEN_S = 0.25
MANY_DAMAGED = 0.02  # of the frames
MAX_WAITING = 4096  # positions that nobody has read yet; the oldest are given up


@frozen
class MarvelmindConfig:
    """
    Attributes:
        ports: one each for beacons that are connected by themselves, one alone for a modem or for a
            beacon that streams all; such as ``/dev/serial/by-id/usb-...``, which stays the same
            when it is plugged in again.
        baud: 500000 is what the beacons' own UART starts with; over USB any will do.
        latency_s: from the ultrasound to the frame at least, of firmware whose frames do not say
            how old they are.
        reopen_s: a port that vanished must be back within this.
    """

    ports: tuple[str, ...]
    baud: Annotated[int, Bounds(4800, 4_000_000, "baud")] = 500_000
    latency_s: Annotated[float, Bounds(0.0, 1.0)] = 0.0
    reopen_s: Annotated[float, Bounds(0.0, 600.0)] = 10.0

    def __post_init__(self) -> None:
        if not self.ports or len(set(self.ports)) < len(self.ports):
            raise ValueError("ports: name at least one port, and each once")
        check_bounds(self)


@dataclass(slots=True)
class _Port:
    """``lost_s``: loop time since which it is gone; None while it is open."""

    name: str
    device: serial.Serial | None = None
    lost_s: float | None = None
    timer: asyncio.TimerHandle | None = None
    why: str = ""


class Marvelmind:
    """Implements ``drivers.interfaces.Beacons``.

    A port that vanishes is opened again when it is back; the others go on meanwhile. When it is not
    back within ``reopen_s``, reading ends with an error that names it.

    Attributes:
        stream: what has come in, by port: counters, batteries, stationary beacons.
        on_bytes: called with (port, arrival_ns, bytes) for all that is read, for a record of it;
            without bytes when a port was lost.
        given_up: positions that nobody read in time.
    """

    Config = MarvelmindConfig

    def __init__(self, config: MarvelmindConfig, context: PartContext) -> None:
        self._config = config
        self._clock: Clock = context.clock
        self._ports = [_Port(name) for name in config.ports]
        self._waiting: deque[BeaconFix] = deque()
        self._news = asyncio.Event()
        self._open = False
        self.stream = MarvelmindStream(config.latency_s)
        self.on_bytes: Callable[[str, int, bytes], None] | None = None
        self.given_up = 0

    async def __aenter__(self) -> Self:
        """Raise BeaconError for a port that cannot be opened."""
        try:
            for port in self._ports:
                self._open_port(port)
                if port.name in self.stream.ports:
                    self._take(port, self._clock.now_ns(), b"")  # what was cut when it was closed
        except BaseException:
            self._close()
            raise
        self._waiting.clear()  # of the time before
        self._open = True
        return self

    async def __aexit__(self, *_: object) -> None:
        self._close()

    async def read(self, timeout_s: float) -> BeaconFix:
        """The oldest position not yet given. Raises BeaconError when none came in time or a port
        stays gone.
        """
        self._check_open()
        try:
            async with asyncio.timeout(timeout_s):
                while not self._waiting:
                    self._check_open()
                    self._check_ports()
                    self._news.clear()
                    await self._news.wait()
        except TimeoutError:
            raise self._silence(timeout_s) from None
        return self._waiting.popleft()

    async def examine(self) -> Sequence[Finding]:
        """Return what each port sent besides positions: damage, and the battery of what is
        connected.
        """
        return [_port_finding(name, state) for name, state in self.stream.ports.items()]

    # --- inside ---

    def _open_port(self, port: _Port) -> None:
        try:
            device = serial.Serial(port.name, self._config.baud, timeout=0, exclusive=True)
        except (serial.SerialException, termios.error, ValueError, OSError) as error:
            raise BeaconError(
                f"serial port {port.name}: {error}",
                "is the beacon plugged in and switched on, the name right, and this user in the group of the port "
                "(dialout)?",
            ) from error
        os.set_blocking(device.fileno(), False)
        port.device = device
        port.lost_s = None
        asyncio.get_running_loop().add_reader(device.fileno(), self._readable, port)

    def _readable(self, port: _Port) -> None:
        """Called by the loop; never raises."""
        assert port.device is not None
        arrival_ns = self._clock.now_ns()
        try:
            data = os.read(port.device.fileno(), READ_AT_ONCE)
        except BlockingIOError:
            return
        except OSError as error:
            data = b""
            port.why = error.strerror or str(error)
        if not data:
            self._lost(port)
            return
        self._take(port, arrival_ns, data)
        while len(self._waiting) > MAX_WAITING:
            self._waiting.popleft()
            self.given_up += 1
        self._news.set()

    def _take(
        self,
        port: _Port,
        arrival_ns: int,
        data: bytes,
    ) -> None:
        if self.on_bytes is not None:
            self.on_bytes(port.name, arrival_ns, data)
        self._waiting.extend(self.stream.feed(port.name, arrival_ns, data))

    def _lost(self, port: _Port) -> None:
        loop = asyncio.get_running_loop()
        self._close_port(port)
        self._take(port, self._clock.now_ns(), b"")
        port.lost_s = loop.time()
        port.timer = loop.call_later(REOPEN_S, self._reopen, port)
        self._news.set()

    def _reopen(self, port: _Port) -> None:
        port.timer = None
        try:
            self._open_port(port)
        except BeaconError as error:
            port.why = str(error)
            port.timer = asyncio.get_running_loop().call_later(REOPEN_S, self._reopen, port)
        self._news.set()

    def _check_open(self) -> None:
        if not self._open:
            raise BeaconError("the beacons are not open", "enter them with `async with` first")

    def _check_ports(self) -> None:
        now_s = asyncio.get_running_loop().time()
        for port in self._ports:
            if port.lost_s is not None and now_s - port.lost_s > self._config.reopen_s:
                raise BeaconError(
                    f"serial port {port.name} is gone for {now_s - port.lost_s:.1f} s: {port.why}",
                    "plug the beacon in again, or see why its power went",
                    final=True,
                )

    def _silence(self, timeout_s: float) -> BeaconError:
        """Return the error of no position: what is wrong with each port, by what it said."""
        said = [f"{port.name} {self._ailment(port)}" for port in self._ports]
        return BeaconError(
            f"no position from the beacons in {timeout_s:g} s: {'; '.join(said)}",
            "in the Dashboard: is the beacon awake, in the map, and streaming by the Marvelmind protocol at this baud?",
        )

    def _ailment(self, port: _Port) -> str:
        if port.lost_s is not None:
            return "was unplugged"
        return ailment_of(self.stream.ports.get(port.name))

    def _close_port(self, port: _Port) -> None:
        if port.timer is not None:
            port.timer.cancel()
            port.timer = None
        if port.device is not None:
            asyncio.get_running_loop().remove_reader(port.device.fileno())
            port.device.close()
            port.device = None

    def _close(self) -> None:
        self._open = False
        for port in self._ports:
            self._close_port(port)
        self._news.set()  # whoever waits is told


def _port_finding(name: str, state: PortState) -> Finding:
    counters = state.counters
    frames = sum(counters.frames.values())
    detail = (
        f"{name}: {frames} frames, {counters.damaged} damaged, {counters.skipped} bytes of no frame"
    )
    if state.power is not None:
        detail += f", battery {state.power.battery_v:.2f} V, radio {state.power.rssi_dbm} dBm"
    if counters.damaged > MANY_DAMAGED * frames:
        return Finding(
            "note",
            "port",
            detail,
            "a shorter cable, the right baud, and no other program on this port",
        )
    return Finding("ok", "port", detail)


def ailment_of(state: PortState | None) -> str:
    """Return why a port that is open gave no position, by all that came from it."""
    if state is None or not state.bytes_read:
        return "is silent"
    counters = state.counters
    if not counters.frames:
        return (
            f"sent {state.bytes_read} bytes and no whole frame (another protocol, or another baud?)"
        )
    if state.unavailable:
        return "streams, but the system has no position for its beacons (out of reach of the stationary ones?)"
    if state.newest_fix_ns is None:
        return "streams, but no positions"
    return "has stopped sending positions"
