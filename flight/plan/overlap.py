"""How far D2's box of the target will overlap D1's own, from the geometry and the errors that last.
Pure.

An upright cuboid that heads in any direction fills a box from either side. Mapped into D1's image
both have the same middle but for an offset o ~ N(0, B) that is drawn once, with B of
``flight.plan.errors``. With widths w and heights h of both boxes and their common part c,

    S = c / (w1 h1 + w2 h2 - c)

and the strength of the agreement is (S - tau) / (1 - tau), as the gate has it. What comes of it is
a share of hand-overs: for how many draws a block of pairs is strong enough.
"""

from __future__ import annotations

import math
from statistics import NormalDist

import numpy as np

from flight.plan.errors import predict
from flight.plan.facts import Facts
from flight.plan.geometry import Layout, boxed_share
from path.arrays import Array
from path.gate.agreement import threshold

HEADINGS = 8
DRAWS = 9  # along each axis of the offset: the middles of as many equal shares


def agreeing_share(
    facts: Facts,
    placed: Layout,
    strength: float,
) -> float:
    """Return the share of hand-overs in which errors that last leave the boxes that strong an
    agreement. Raises ValueError for a layout without a viewpoint.
    """
    return float(np.mean(strengths(facts, placed) >= strength))


def strengths(facts: Facts, placed: Layout) -> Array:
    """Return the strength of the agreement by heading and draw, shape (n,). Raises ValueError for a
    layout without a viewpoint.
    """
    if placed.T_h_c2 is None:
        raise ValueError("a layout without a viewpoint has no pairs")
    tau = threshold(placed.range_m, facts.method)
    offsets_m = _offsets(predict(facts, placed).offset_cov_m2)
    eyes = (facts.sender.mount.T_b_c.t, placed.T_h_c2.t)
    found: list[Array] = []
    for k in range(HEADINGS):
        heading_rad = 2.0 * math.pi * (k + 0.5) / HEADINGS
        sides_m = [_sides(facts, heading_rad, placed.target_h - eye) for eye in eyes]
        found.append(_overlap(sides_m[0], sides_m[1], offsets_m))
    return (np.concatenate(found) - tau) / (1.0 - tau)


def _offsets(covariance: Array) -> Array:
    """Return evenly likely draws from a normal distribution about 0, shape (DRAWS ** 2, 2)."""
    quantiles = [NormalDist().inv_cdf((k + 0.5) / DRAWS) for k in range(DRAWS)]
    grid = np.stack(np.meshgrid(quantiles, quantiles), axis=-1).reshape(-1, 2)
    return np.asarray(grid @ np.linalg.cholesky(covariance).T, np.float64)


def _sides(
    facts: Facts,
    heading_rad: float,
    to_target: Array,
) -> tuple[float, float]:
    """Return width and height in m of the target's box, at its own depth."""
    target = facts.target
    ahead = float(to_target[0])
    right = float(to_target[1])
    down = float(to_target[2])
    turned = heading_rad - math.atan2(right, ahead)
    sinking = math.atan2(down, math.hypot(ahead, right))
    along = abs(math.cos(turned))
    across = abs(math.sin(turned))
    wide_m = target.length_m * across + target.width_m * along
    deep_m = target.length_m * along + target.width_m * across
    high_m = target.height_m * math.cos(sinking) + deep_m * math.sin(sinking)
    share = boxed_share(target)
    return share * wide_m, share * high_m


def _overlap(
    own_m: tuple[float, float],
    other_m: tuple[float, float],
    offsets_m: Array,
) -> Array:
    """Return the intersection over union of two boxes by the offset of their middles."""
    common = np.ones(len(offsets_m))
    for axis in (0, 1):
        near = np.minimum(0.5 * own_m[axis], 0.5 * other_m[axis] + offsets_m[:, axis])
        far = np.maximum(-0.5 * own_m[axis], -0.5 * other_m[axis] + offsets_m[:, axis])
        common = common * np.maximum(0.0, near - far)
    both = own_m[0] * own_m[1] + other_m[0] * other_m[1]
    return common / (both - common)
