"""One drone's true motion from the messages of its simulator: smooth between them and finer than
their units.

MAVLink carries latitude and longitude in 1e-7 degrees, which is 11 mm of north. Drawn like that, a
hovering drone would jump by more than the marker's corners may move. Its true velocity comes along,
far finer, so the position is the integral of the velocity, drawn towards the reported one with
``TAU_S``.
"""

from __future__ import annotations

import math

import numpy as np

from hil.world.dynamics import (
    ATTITUDE,
    CONTACT,
    POSITION,
    RATES,
    ROTOR_PHASE,
    STATE_SIZE,
    VELOCITY,
    Array,
)
from path.geometry.rotation import multiply
from path.messages import Quat, Vec3
from path.values import frozen

TAU_S = 0.5
JUMP_M = 1.0  # farther off than this it was moved, and is not flown there
IN_AIR_M = 0.05  # above where it stood
RISEN_M = 1.0  # above the ground, from where on a barometer is wrong by all it is to be wrong by
ROTOR_RADPS = 380.0


@frozen
class TrueMotion:
    """The true motion but for the position, at ``time_s``: velocity NED, attitude body to NED, body
    rates.
    """

    time_s: float
    velocity_n_mps: Vec3
    q_n_b: Quat
    rates_radps: Vec3


@frozen
class Fix:
    """A reported position, coarse. NaN for what the message does not tell."""

    time_s: float
    position_n_m: Vec3


class TruthFollower:
    """Takes motions and fixes as they arrive; gives the state at any time soon after."""

    def __init__(self, leg_m: float, told_off_n_m: Vec3 = (0.0, 0.0, 0.0)) -> None:
        """``told_off_n_m``: what the simulator tells less what is to be true; of the height only in
        the air.
        """
        self._leg_m = leg_m
        self._told_off_n_m = told_off_n_m
        self._motion: TrueMotion | None = None
        self._position: list[float] = [math.nan] * 3
        self._fixed_s: list[float] = [math.nan] * 3
        self._ground_m: float | None = None

    @property
    def ready(self) -> bool:
        return self._motion is not None and not any(map(math.isnan, self._position))

    @property
    def newest_s(self) -> float:
        """Time of the newest motion; -inf before the first."""
        return self._motion.time_s if self._motion else -math.inf

    def on_motion(self, motion: TrueMotion) -> None:
        """Integrate up to it, by the trapezoid of both velocities."""
        last = self._motion
        if last is not None:
            step_s = motion.time_s - last.time_s
            for axis in range(3):
                mean = 0.5 * (last.velocity_n_mps[axis] + motion.velocity_n_mps[axis])
                self._position[axis] += mean * step_s
        self._motion = motion

    def on_fix(self, fix: Fix) -> None:
        """Draw the position towards it. Before the first motion it says nothing: there is no time
        to reckon from.
        """
        motion = self._motion
        if motion is None:
            return
        late_s = fix.time_s - motion.time_s
        for axis, reported in enumerate(fix.position_n_m):
            if math.isnan(reported):
                continue
            off = reported - (self._position[axis] + motion.velocity_n_mps[axis] * late_s)
            since_s = fix.time_s - self._fixed_s[axis]
            self._fixed_s[axis] = fix.time_s
            if math.isnan(off) or abs(off) > JUMP_M:
                self._position[axis] = reported - motion.velocity_n_mps[axis] * late_s
            else:
                self._position[axis] += (1.0 - math.exp(-since_s / TAU_S)) * off
        if self._ground_m is None and not math.isnan(self._position[2]):
            self._ground_m = self._position[2]

    def row(self, time_s: float) -> Array:
        """Return a state row of ``hil.world.dynamics`` at ``time_s``, carried on from the newest
        motion.

        Only when ``ready``.
        """
        motion = self._motion
        assert motion is not None and self._ground_m is not None
        late_s = max(0.0, time_s - motion.time_s)
        row = np.zeros(STATE_SIZE)
        row[POSITION] = self._position
        row[VELOCITY], row[RATES] = motion.velocity_n_mps, motion.rates_radps
        row[POSITION] += late_s * row[VELOCITY]
        row[ATTITUDE] = _turned(motion.q_n_b, motion.rates_radps, late_s)
        off_north_m, off_east_m, off_down_m = self._told_off_n_m
        risen = min(1.0, max(0.0, float(self._ground_m - row[2]) / RISEN_M))
        row[POSITION] -= off_north_m, off_east_m, risen * off_down_m
        # The simulators put the body's origin where it touches; here it is a leg above that.
        row[2] -= self._leg_m
        row[CONTACT] = float(self._ground_m - self._position[2] < IN_AIR_M)
        row[ROTOR_PHASE] = (ROTOR_RADPS * time_s) % (2.0 * math.pi)
        return row


def _turned(
    q: Quat,
    rates: Vec3,
    seconds: float,
) -> Quat:
    x, y, z = (0.5 * seconds * rate for rate in rates)
    turned = multiply(q, (1.0, x, y, z))
    size = math.hypot(*turned)
    w, x, y, z = (value / size for value in turned)
    return w, x, y, z
