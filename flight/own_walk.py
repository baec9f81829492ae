"""A position that walks: what it moves by without its velocity, which is no motion of the vehicle.

A GPS that walks moves a position by centimetres from frame to frame, and its velocity says nothing
of it. Everything that a camera shows would seem to move by it together. Two errors have a part in
what the velocity does not explain: that of the position walks by D_p in a second, that of the
integrated velocity by D_v (m^2/s). Where the vehicle is, as well as both tell, moves on by the
share of such a residual

    K = sqrt(D_v / (D_v + D_p))

(the stationary gain of a Kalman filter whose state is the place, and whose measurement is that
place with the walk added). The rest is the position's own, and taken out. D_v + D_p is the mean
square of the residuals over WINDOW_S, learned from the moment on from which the vehicle is
armable. As long as that is within WALKS of D_v, positions are followed as they are.
"""

from __future__ import annotations

import math

from path.values import value

# of an autopilot's velocity: what its integral walks by, m^2/s; 0.03 m/s that last for 3 s
DRIFT = 2.0 * 0.03**2 * 3.0
WALKS = 4.0
WINDOW_S = 1.0  # telemetry that comes late has made up for it by then
LEARNED = 4  # windows
FORGET = 0.05  # of what was learned, by each window


@value
class _Learned:
    """The mean square of residuals, m^2/s, of so many windows."""

    rate: float = 0.0
    windows: int = 0

    def noted(self, rate: float) -> _Learned:
        weight = max(FORGET, 1.0 / (self.windows + 1))
        return _Learned(self.rate + weight * (rate - self.rate), self.windows + 1)


class OwnWalk:
    """Of one axis, or of several that walk alike.

    Args:
        axes: how many.
    """

    def __init__(self, axes: int) -> None:
        self._sum_m = [0.0] * axes
        self._since_s = 0.0
        self._learned = _Learned()

    def taken_out(self, residual_m: tuple[float, ...], dt_s: float) -> tuple[float, ...]:
        """Note what the velocity does not explain of a way of dt_s; return what of it is no motion."""
        self._sum_m = [total + each for total, each in zip(self._sum_m, residual_m, strict=True)]
        self._since_s += dt_s
        if self._since_s >= WINDOW_S:
            square_m2 = sum(total * total for total in self._sum_m) / len(self._sum_m)
            self._learned = self._learned.noted(square_m2 / self._since_s)
            self._sum_m = [0.0] * len(self._sum_m)
            self._since_s = 0.0
        share = self._share
        if not share:
            return (0.0,) * len(residual_m)
        return tuple(share * each for each in residual_m)

    @property
    def _share(self) -> float:
        learned = self._learned
        if learned.windows < LEARNED or learned.rate <= WALKS * DRIFT:
            return 0.0
        return 1.0 - math.sqrt(DRIFT / learned.rate)
