"""A pose that turns over between two frames is the wrong one of the two planar solutions, not a drone that flipped."""

from __future__ import annotations

import math

import numpy as np

from path.geometry import Matrix
from path.observations import Missed, MissReason


class FlipGate:
    """Gates the marker's attitude in a frame that does not turn with the camera (``R_n_v``).

    Args:
        step_rad: how far two consecutive attitudes may be apart, and per second since how much more.
        settle: this many refused attitudes in a row that agree with each other replace the old one.
    """

    def __init__(self, step_rad: float = math.radians(20.0), rate_rad_s: float = math.radians(60.0), settle: int = 15):
        self._step_rad, self._rate_rad_s, self._settle = step_rad, rate_rad_s, settle
        self._accepted: tuple[int, Matrix] | None = None
        self._refused: tuple[int, Matrix] | None = None
        self._refusals = 0

    def check(self, R_n_v: Matrix, stamp_ns: int) -> Missed | None:
        """None when the attitude continues what was; MARKER_FLIPPED otherwise."""
        if self._accepted is None or self._near(self._accepted, R_n_v, stamp_ns):
            self._accepted, self._refused, self._refusals = (stamp_ns, R_n_v), None, 0
            return None
        again = self._refused is not None and self._near(self._refused, R_n_v, stamp_ns)
        self._refusals = self._refusals + 1 if again else 1
        self._refused = (stamp_ns, R_n_v)
        if self._refusals >= self._settle:
            self._accepted, self._refused, self._refusals = self._refused, None, 0
        return Missed(MissReason.MARKER_FLIPPED)

    def _near(self, before: tuple[int, Matrix], R_n_v: Matrix, stamp_ns: int) -> bool:
        then_ns, R = before
        cosine = 0.5 * (float(np.sum(R * R_n_v)) - 1.0)
        limit = self._step_rad + self._rate_rad_s * abs(stamp_ns - then_ns) * 1e-9
        return math.acos(min(1.0, max(-1.0, cosine))) <= limit
