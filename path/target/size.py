"""The size of a box in metres: whether it can be of the target alone, or is drawn around more than
that.

A box's sides times the distance over the focal length are lengths across the line of sight. Two
things are known of those of one body, and both are upper limits: what hides a part of it makes its
box smaller.

- What the target is (``EvidenceConfig.span_m``, ``height_m``): it stands in an upright cylinder,
  whichever way it heads. Along a direction ``a`` of the image that reaches over ``height |a.g| +
  span sqrt(a.a - (a.g)^2)``, where ``g`` is gravity. A car that turns, or a person who does, stays
  within it.
- What it was a moment ago: a body that turns does so steadily, but two that are taken for one make
  the box larger from one frame to the next. Each camera's box is held against its own running mean,
  once that is ``SURE_S`` old: an object that comes into view grows too. The mean rises within
  ``SETTLE_S`` and falls within ``LEARNED_S``: what was hidden for a moment is no larger afterwards
  than it was. A box that has outgrown it teaches nothing, for ``LEARNED_S`` at most: then it is
  what the target looks like.

How far a box is above a limit is counted in standard deviations of the logarithm of its size, and
both cameras', both sides' and both limits' largest number is that of a pair. One that is above
``size_sigmas`` is of something else, as far as the gate ``evidence`` is concerned
(``path.gate.evidence``).
"""

from __future__ import annotations

import math

from path.config import MethodConfig
from path.gate.agreement import Comparison, TwoViews
from path.gate.kernels import sized
from path.messages import Vec3
from path.observations import Box, Depth

SETTLE_S = 0.15
"""Time constant of the running mean as it rises: so long a turning target may have changed
since.
"""
SURE_S = 0.5
LEARNED_S = 3.0
FITS = 0.0
"""Of a pair of which no limit is known."""


class RunningSize:
    """The size of one camera's box over its last frames, as logarithms of both sides in m.

    ``sure_s``: how old its mean must be to say that a box has outgrown it.
    """

    def __init__(self, sure_s: float = SURE_S) -> None:
        self._sure_ns = round(sure_s * 1e9)
        self._mean: tuple[float, float] | None = None
        self._first_ns = self._stamp_ns = 0  # of the first and the newest box that fitted

    @property
    def sides_m(self) -> tuple[float, float] | None:
        """Both sides, as they are in the mean; None before the first box."""
        return None if self._mean is None else (math.exp(self._mean[0]), math.exp(self._mean[1]))

    def note(
        self,
        stamp_ns: int,
        sides_m: tuple[float, float],
        sigma: float,
        most_sigmas: float,
    ) -> float:
        """Return by how many standard deviations a box is larger than those before it.

        Learns from it when it fits.
        """
        logs = math.log(sides_m[0]), math.log(sides_m[1])
        mean = self._mean
        since_s = max(0.0, (stamp_ns - self._stamp_ns) * 1e-9)
        grown = FITS if mean is None else max(logs[0] - mean[0], logs[1] - mean[1]) / sigma
        unsure = grown > most_sigmas and self._stamp_ns - self._first_ns < self._sure_ns
        if mean is None or unsure or since_s > LEARNED_S:
            self._mean = logs
            self._first_ns = stamp_ns
            self._stamp_ns = stamp_ns
            return FITS
        if grown <= most_sigmas:
            self._mean = _followed(mean[0], logs[0], since_s), _followed(mean[1], logs[1], since_s)
            self._stamp_ns = max(stamp_ns, self._stamp_ns)
        return grown


def _followed(
    mean: float,
    new: float,
    since_s: float,
) -> float:
    return mean - math.expm1(-since_s / (SETTLE_S if new > mean else LEARNED_S)) * (new - mean)


class Sizes:
    """The sizes of both drones' boxes of the target in one attempt."""

    def __init__(self, views: TwoViews, config: MethodConfig) -> None:
        self._views = views.numbers
        self._config = config
        self._body = config.evidence.span_m, config.evidence.height_m
        self._own, self._theirs = RunningSize(), RunningSize()

    def own(
        self,
        stamp_ns: int,
        box: Box,
        depth: Depth,
        point_v: Vec3,
        gravity_v: Vec3,
    ) -> float:
        """Return how much too large D1's box in its newest frame is, in standard deviations."""
        wide_m, high_m, larger = sized(
            self._views,
            self._body,
            box.w,
            box.h,
            depth.z_m,
            point_v,
            gravity_v,
        )
        return self._above(
            self._own,
            stamp_ns,
            box,
            depth.sigma_m / depth.z_m,
            (wide_m, high_m),
            larger,
        )

    def theirs(
        self,
        stamp_ns: int,
        box: Box,
        range_sigma_m: float,
        found: Comparison,
    ) -> float:
        """The same of D2's, at the range at which its camera has the target's point."""
        if not found.range_m > 0.0:
            return FITS
        by_range = range_sigma_m / found.range_m
        return self._above(self._theirs, stamp_ns, box, by_range, found.sides_m, found.larger)

    def _above(
        self, running: RunningSize, stamp_ns: int, box: Box, by_range: float, sides_m: tuple[float, float],
        larger: float,
    ) -> float:  # fmt: skip
        own = self._config.evidence
        # an edge's noise is 1.4 times the centre's, a side's twice
        pixels = 2.0 * self._config.pixel_sigma_px / max(1.0, min(box.w, box.h))
        measured = math.hypot(pixels, by_range)
        above = running.note(
            stamp_ns,
            sides_m,
            math.hypot(measured, own.growth_sigma),
            own.size_sigmas,
        )
        if own.span_m > 0.0:
            above = max(above, math.log(larger) / math.hypot(measured, own.size_sigma))
        return above
