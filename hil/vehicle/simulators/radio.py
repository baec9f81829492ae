"""The transmitter of a pilot whose vehicle is flown by a real autopilot's simulator.

ArduPilot's simulator takes pulse widths by UDP, on a port that follows from its instance, and goes
on with the last ones when no more come: the loss of a radio is a parameter of it. PX4's takes
RC_CHANNELS_OVERRIDE for what a receiver on board heard, and notices by itself when no more come.

It sends from a thread of its own: a transmitter does not wait for a world that is late.
"""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
import time
from collections.abc import Mapping
from typing import Protocol

from hil.autopilot.radio import CHANNELS, RadioConfig, Transmitter, channels_of
from hil.autopilot.simulator import Kind

SEND_S = 0.04
# ArduPilot's for its first instance
FIRST_PORT = 5501
PORTS_APART = 10
FAIL = "SIM_RC_FAIL"
NO_PULSES = 1.0

_NUMBERS = range(1, CHANNELS + 1)
SET_UP: Mapping[Kind, Mapping[str, float]] = {
    "px4": {
        "RC_CHAN_CNT": CHANNELS,
        **{
            f"RC{n}_{what}": us
            for n in _NUMBERS
            for what, us in (("MIN", 1000), ("TRIM", 1500), ("MAX", 2000))
        },
        "RC_MAP_ROLL": 1,
        "RC_MAP_PITCH": 2,
        "RC_MAP_THROTTLE": 3,
        "RC_MAP_YAW": 4,
        "RC_MAP_FLTMODE": 5,
        "RC_MAP_KILL_SW": 7,
        # hold, position, land, return, hold, hold
        **{
            f"COM_FLTMODE{n}": mode
            for n, mode in zip(range(1, 7), (4, 2, 11, 5, 4, 4), strict=True)
        },
    },
    "ardupilot": {
        **{
            f"RC{n}_{what}": us
            for n in _NUMBERS
            for what, us in (("MIN", 1000), ("TRIM", 1500), ("MAX", 2000))
        },
        "RC2_REVERSED": 1,  # here a stick that is pushed forward is a wide pulse
        # its throttle springs to the middle: one that is not down is no reason not to arm
        "PILOT_THR_BHV": 1,
        "FLTMODE_CH": 5,
        "RC7_OPTION": 31,  # Motor Emergency Stop
        # altitude hold, loiter, land, return, brake, brake
        **{f"FLTMODE{n}": mode for n, mode in zip(range(1, 7), (2, 5, 9, 6, 17, 17), strict=True)},
    },
}
"""A transmitter that was calibrated, with the switches of ``hil.autopilot.radio.SLOTS``. What an
autopilot is to make of it in flight stands with the vehicle."""


class RadioWire(Protocol):
    """The part of ``hil.vehicle.simulators.link.SimulatorLink`` that a transmitter needs."""

    @property
    def parameters(self) -> Mapping[str, float]: ...

    def set_parameter(self, name: str, value: float, /) -> None: ...

    def send_channels(self, channels: tuple[int, ...], /) -> None: ...


class SimulatedRadio:
    """The pilot's transmitter, as one simulator hears it, from ``start`` to ``close``.

    Attributes:
        transmitter: the pilot's; a harness moves it.
        lost: it is off, or out of reach, as of the newest ``pump``.
    """

    def __init__(
        self,
        kind: Kind,
        sysid: int,
        wire: RadioWire,
    ) -> None:
        self.transmitter = Transmitter()
        self.lost = False
        self._kind: Kind = kind
        self._wire = wire
        self._config = RadioConfig()
        self._port = FIRST_PORT + PORTS_APART * (sysid - 1)
        self._asked_s = -SEND_S
        self._closed = threading.Event()
        self._thread: threading.Thread | None = None
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)

    def start(self) -> None:
        self._thread = threading.Thread(target=self._run, name="transmitter", daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._closed.set()
        if self._thread is not None:
            self._thread.join()
        self._socket.close()

    def pump(self, world_s: float) -> None:
        """Take over what the harness wants of its reach. ``world_s``: the world's clock."""
        own = self.transmitter
        self.lost = not own.on or world_s < own.away_until_s
        if self._kind == "ardupilot":
            self._fail(self.lost)

    def send(self) -> None:
        """Send the channels once, if it is heard at all."""
        if self.lost:
            return
        channels = channels_of(self.transmitter, self._config)
        if self._kind == "px4":
            self._wire.send_channels(channels)
            return
        packet = struct.pack(f"<{CHANNELS}H", *channels)
        with contextlib.suppress(OSError):
            self._socket.sendto(packet, ("127.0.0.1", self._port))

    def _run(self) -> None:
        while not self._closed.wait(SEND_S):
            self.send()

    def _fail(self, fails: bool) -> None:
        """Asked for until it was taken; nothing where it never failed."""
        found = self._wire.parameters.get(FAIL, 0.0)
        wanted = NO_PULSES if fails else 0.0
        if found != wanted and time.monotonic() - self._asked_s > SEND_S:
            self._asked_s = time.monotonic()
            self._wire.set_parameter(FAIL, wanted)
