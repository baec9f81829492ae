"""The pilot's transmitter, and what an autopilot in the manner of PX4 makes of it: switches,
sticks, loss.

Channels are pulse widths in µs: 1 to 4 are roll, pitch, throttle and yaw, the mode switch and the
kill switch are where the parameters say. Only what changes is an order: a switch that already stood
there when the radio was first heard, or heard again, orders nothing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

from drivers.interfaces import FlightMode
from path.bounds import Bounds
from path.values import frozen

Sticks = tuple[float, float, float, float]

CENTRED: Sticks = (0.0, 0.0, 0.0, 0.0)
LOW_US = 1000
MIDDLE_US = 1500
HIGH_US = 2000
CHANNELS = 8
# of RC_CHANNELS_OVERRIDE: the transmitter's value counts
RELEASED = 0
UNCHANGED = 0xFFFF
DEADBAND = 0.1
STICK_MEMORY_S = 0.5  # a stick that moves slower than this is no grab
SLOTS = (
    FlightMode.HOLD,
    FlightMode.OTHER,
    FlightMode.LAND,
    FlightMode.RETURN,
    FlightMode.HOLD,
    FlightMode.HOLD,
)
"""The modes that the switch's positions select; OTHER is flown by sticks."""

HOLD_SLOT = 0
STICKS_SLOT = 1
# bits of ``override``
IN_AUTO = 1
IN_OFFBOARD = 2
# bits of ``loss_except``
EXCEPT_HOLD = 2
EXCEPT_OFFBOARD = 4
# of ``loss_act``; anything else stays in hold
LOSS_RETURNS = 2
LOSS_LANDS = 3


@frozen
class RadioConfig:
    """The autopilot's settings for its radio control: PX4's parameters, here by their meaning.

    Attributes:
        in_mode: COM_RC_IN_MODE. 1 and 4 hear no transmitter.
        override: COM_RC_OVERRIDE. Bit 0: sticks take over from modes that fly by themselves; bit 1:
            from OFFBOARD.
        stick_override: COM_RC_STICK_OV, as a share of the stick's half way.
        loss_s: COM_RC_LOSS_T.
        loss_except: COM_RCL_EXCEPT. Bit 1: loss does not count in HOLD and take-off; bit 2: nor in
            OFFBOARD.
        loss_act: NAV_RCL_ACT. 1 hold, 2 return, 3 land.
        act_after_s: COM_FAIL_ACT_T, in hold before that.
        kill_disarm_s: COM_KILL_DISARM. Until then the motors stand still and the vehicle calls
            itself armed.
        mode_channel, kill_channel: RC_MAP_FLTMODE and RC_MAP_KILL_SW; 0: there is no such switch.
        fitted: a receiver is on board, and a transmitter is switched on.
    """

    in_mode: Annotated[int, Bounds(0, 8, "(a mode)")] = 0
    override: Annotated[int, Bounds(0, 3, "(bits)")] = 3
    stick_override: Annotated[float, Bounds(0.05, 0.8, "of 1")] = 0.3
    loss_s: Annotated[float, Bounds(0.0, 35.0)] = 0.5
    loss_except: Annotated[int, Bounds(0, 31, "(bits)")] = 0
    loss_act: Annotated[int, Bounds(1, 6, "(an action)")] = 3
    act_after_s: Annotated[float, Bounds(0.0, 25.0)] = 5.0
    kill_disarm_s: Annotated[float, Bounds(0.0, 30.0)] = 5.0
    mode_channel: Annotated[int, Bounds(0, CHANNELS, "(a channel)")] = 5
    kill_channel: Annotated[int, Bounds(0, CHANNELS, "(a channel)")] = 7
    fitted: bool = True

    @property
    def hears(self) -> bool:
        """Return whether any transmitter can take the vehicle."""
        return self.in_mode not in (1, 4)


@dataclass(slots=True)
class Transmitter:
    """The transmitter in the pilot's hands. Sticks -1..1: right, forward, up, clockwise."""

    on: bool = True
    away_until_s: float = -math.inf  # out of range until then, on the world's clock
    slot: int = HOLD_SLOT
    kill: bool = False
    sticks: Sticks = CENTRED


@frozen
class PilotInput:
    """The pilot's input as the autopilot understands its radio in one step.

    Attributes:
        heard: there is a radio that counts.
        mode: selected just now.
        kill: the kill switch was just set to this.
        moved: a stick was just moved farther than a pilot moves it who does not want the vehicle.
    """

    heard: bool
    mode: FlightMode | None = None
    kill: bool | None = None
    moved: bool = False
    sticks: Sticks = CENTRED


SILENT = PilotInput(False)


class Radio:
    """The receiver on board. ``channels`` are the newest it heard.

    Attributes:
        transmitter: the pilot's; a harness moves it.
    """

    def __init__(self) -> None:
        self.transmitter = Transmitter()
        self.channels: tuple[int, ...] = (MIDDLE_US,) * CHANNELS
        self.heard_s = -math.inf
        self._override: tuple[float, tuple[int, ...]] = (-math.inf, (RELEASED,) * CHANNELS)
        self._switches: tuple[int, bool] | None = None  # None: not known since it was last lost
        self._slow: Sticks = CENTRED
        self._stepped_s = -math.inf
        # as both were, and what came then
        self._sent: tuple[RadioConfig, Transmitter, tuple[int, ...]] | None = None
        # while nothing moves, step after step
        self._steady: tuple[tuple[int, ...], PilotInput] | None = None

    def override(self, now_s: float, channels: Sequence[int]) -> None:
        """Channels from a ground station, in the transmitter's place where they say something."""
        self._override = now_s, tuple(channels[:CHANNELS])

    def step(self, now_s: float, config: RadioConfig) -> PilotInput:
        """Hear what is there to be heard now."""
        dt_s = min(1.0, now_s - self._stepped_s)
        self._stepped_s = now_s
        self._hear(now_s, config)
        if not config.hears or now_s - self.heard_s > config.loss_s:
            self._switches = self._steady = None
            return SILENT
        if self._steady is not None and self._steady[0] is self.channels:
            return self._steady[1]
        roll, pitch, throttle, yaw = (_stick(us) for us in self.channels[:4])
        sticks = roll, pitch, throttle, yaw
        slot = _slot(self._channel(config.mode_channel))
        kill = self._channel(config.kill_channel) > MIDDLE_US
        before = self._switches
        self._switches = (slot, kill)
        if before is None:
            self._slow = sticks
        moved = any(
            abs(a - b) > config.stick_override for a, b in zip(sticks, self._slow, strict=True)
        )
        share = min(1.0, dt_s / STICK_MEMORY_S)
        r, p, t, y = (
            slow + share * (now - slow) for now, slow in zip(sticks, self._slow, strict=True)
        )
        self._slow = r, p, t, y
        known = before or (slot, kill)
        heard = PilotInput(
            heard=True,
            mode=SLOTS[slot] if slot != known[0] else None,
            kill=kill if kill != known[1] else None,
            moved=moved,
            sticks=sticks,
        )
        rests = known == (slot, kill) and not moved and self._slow == sticks
        self._steady = (self.channels, heard) if rests else None
        return heard

    def _hear(self, now_s: float, config: RadioConfig) -> None:
        own = self.transmitter
        sent_s, forced = self._override
        overridden = now_s - sent_s <= config.loss_s
        there = own.on and config.fitted and now_s >= own.away_until_s
        if not there and not overridden:
            return
        if self._sent is None or self._sent[0] is not config or self._sent[1] != own:
            self._sent = config, replace(own), channels_of(own, config)
        heard = self._sent[2]
        if overridden:
            pairs = zip(forced, heard, strict=False)
            heard = tuple(usual if us in (RELEASED, UNCHANGED) else us for us, usual in pairs)
        self.channels = heard
        self.heard_s = now_s

    def _channel(self, number: int) -> int:
        return self.channels[number - 1] if 0 < number <= len(self.channels) else LOW_US


def channels_of(own: Transmitter, config: RadioConfig) -> tuple[int, ...]:
    """Return the pulse widths in µs that a transmitter sends."""
    channels = [round(MIDDLE_US + 500.0 * min(1.0, max(-1.0, stick))) for stick in own.sticks]
    channels += [LOW_US] * (CHANNELS - len(channels))
    if config.mode_channel:
        channels[config.mode_channel - 1] = (
            LOW_US + 1000 * own.slot // len(SLOTS) + 1000 // (2 * len(SLOTS))
        )
    if config.kill_channel:
        channels[config.kill_channel - 1] = HIGH_US if own.kill else LOW_US
    return tuple(channels)


def _stick(us: int) -> float:
    return min(1.0, max(-1.0, (us - MIDDLE_US) / 500.0))


def _slot(us: int) -> int:
    return min(len(SLOTS) - 1, max(0, (us - LOW_US) * len(SLOTS) // 1000))


def flown_by(
    sticks: Sticks,
    yaw_rad: float,
    fastest_mps: float,
) -> tuple[float, float, float] | None:
    """The velocity that sticks ask for, NED m/s; None while they are centred."""
    right, forward, up = (
        0.0 if abs(stick) < DEADBAND else stick * fastest_mps for stick in sticks[:3]
    )
    if right == forward == up == 0.0:
        return None
    cos = math.cos(yaw_rad)
    sin = math.sin(yaw_rad)
    return forward * cos - right * sin, forward * sin + right * cos, -up
