"""The offset between two clocks by generalised least squares: what errs together in time or place
counts as such.

The model of the residuals between a beacon's positions and a vehicle's own ones, by axis,
independent of each other (``T`` is the time over which the vehicle's own positions were steadied,
weights ``exp(-|t|/T)/2T``; ``u = |dt|/T``):

- a constant shift of each vehicle's estimate (any; free);
- white noise of a position of the beacons, ``noise_m``;
- jitter of the vehicle's positions, white before they were steadied, ``jitter_m``: covariance ``(1
  + u) exp(-u)``;
- a random walk of the vehicle's positions, ``walk_m_per_sqrt_s``, steadied likewise: spectrum
  ``1 / (w^2 (1 + (w T)^2)^2)``, thus covariance ``-|dt|/2 - (3 T/4 + |dt|/4) exp(-u)`` up to a
  constant that the free shift takes;
- a static warp of the beacons' frame, ``warp_m``, that all beacons share and that changes over
  ``WARP_LENGTH_M``: ``exp(-D^2 / 2 L^2)`` for places ``D`` apart.

The four standard deviations are those that are likeliest given the records alone: restricted
maximum likelihood (Patterson and Thompson 1971), by average information (Gilmour, Thompson and
Cullis 1995). Kernels as in Rasmussen and Williams, Gaussian Processes for Machine Learning (2006),
chapter 4. A warp is then what it is: where all places are passed in one direction only, an offset
cannot be told from it, and the standard deviation says so.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from missions.trials.shared.trajectory import Alignment, MotionPair, huber
from path.arrays import Array, Whole
from path.geometry.rotation import exp
from path.values import frozen

# positions within this are one mean: nothing that moves a drone is quicker, and matrices stay small
BLOCK_S = 0.5
WARP_LENGTH_M = 2.0  # half the way between stationary beacons, about; 1.5 m does as well
# noise, jitter, walk, warp: where the search for the likeliest begins
START_M = (0.02, 0.02, 0.01, 0.01)
LEAST_M = 0.001  # of each of them
ROUNDS = 5
SEARCH_STEPS = 25
MOST_CHANGE = 1.5  # of the logarithm of a variance in one step


@frozen
class Spreads:
    """Standard deviations per axis; the module's text says of what."""

    noise_m: float
    jitter_m: float
    walk_m_per_sqrt_s: float
    warp_m: float


@frozen
class OffsetFit:
    """``offset_sigma_s`` is for the likeliest spreads; ``yaw_rad`` turns curves to samples about
    the vertical.
    """

    offset_s: float
    offset_sigma_s: float
    yaw_rad: float
    spreads: Spreads


def fit_offset(
    pairs: Sequence[MotionPair],
    start: Alignment,
    steady_s: float,
) -> OffsetFit:
    """Offset of samples to curves of several vehicles in one frame of beacons that is turned about
    the vertical.

    Args:
        pairs: curves are of vehicles' own positions, steadied over ``steady_s``; samples are of
            beacons.
        start: a robust alignment of the same pairs; which samples count, and how much, is taken
            from it.

    Raises:
        ValueError: a pair has no sample that counts, or nothing moved.
    """
    weights = [
        np.where(used, huber(np.nan_to_num(residuals), scale_m), 0.0)
        for used, residuals, scale_m in zip(
            start.used,
            start.residuals,
            start.scales_m,
            strict=True,
        )
    ]
    if any(not np.any(own > 0.5) for own in weights):
        raise ValueError("no sample of a vehicle's beacon fits its own motion")
    offset_s = start.offset_s
    yaw_rad = start.yaw_rad
    sigma_s = math.inf
    spreads = 2.0 * np.log(START_M)
    try:
        for _ in range(ROUNDS):
            means = _means(pairs, weights, offset_s, yaw_rad)
            spreads, solution = _likeliest(spreads, _kernels(means, steady_s), means)
            step_s, turn_rad = solution.unknowns[:2].tolist()
            offset_s = offset_s + step_s
            yaw_rad = yaw_rad + turn_rad
            sigma_s = math.sqrt(float(solution.covariance[0, 0]))
            if abs(step_s) < 1e-6:
                break
    except np.linalg.LinAlgError as error:
        raise ValueError("nothing moved: the offset between the clocks cannot be told") from error
    return OffsetFit(offset_s, sigma_s, yaw_rad, Spreads(*np.exp(0.5 * spreads).tolist()))


@frozen
class _Means:
    """Means over blocks of time, of all pairs.

    Attributes:
        t, place: (n,) and (n, 3) where the vehicle is by its own estimate, turned; it has none of a
            sample's noise, which a warp over the samples' places would explain away.
        count: (n,) samples in each, by weight. pair: (n,).
        residual: (3, n), samples minus curve, by axis. jacobian: (3, n, unknowns): offset, turn,
            and shifts.
    """

    t: Array
    place: Array
    count: Array
    pair: Whole
    residual: Array
    jacobian: Array


def _means(
    pairs: Sequence[MotionPair],
    weights: Sequence[Array],
    offset_s: float,
    yaw_rad: float,
) -> _Means:
    R = exp(np.array([0.0, 0.0, yaw_rad]))
    rows = list[Array]()
    of = list[int]()
    for k, (pair, weight) in enumerate(zip(pairs, weights, strict=True)):
        t = pair.samples.t
        placed = pair.curve.at(t + offset_s) @ R.T
        velocity = pair.curve.velocity_at(t + offset_s) @ R.T
        fine = (weight > 0.0) & np.isfinite(placed[:, 0]) & np.isfinite(velocity[:, 0])
        apart = pair.samples.p[fine] - placed[fine]
        turning = np.cross([0.0, 0.0, 1.0], placed[fine])
        data = np.column_stack(
            [t[fine], placed[fine] + np.median(apart, axis=0), apart, velocity[fine], turning]
        )
        _, block = np.unique(((t[fine] - t[0]) / BLOCK_S).astype(np.int64), return_inverse=True)
        sums = np.zeros((int(block.max()) + 1, data.shape[1] + 1))
        np.add.at(sums, block, np.column_stack([data, np.ones(len(data))]) * weight[fine, None])
        sums = sums[sums[:, -1] > 0.5]
        sums[:, :-1] /= sums[:, -1:]
        rows.append(sums)
        of += [k] * len(sums)
    table = np.concatenate(rows)
    pair_of = np.array(of)
    jacobian = np.zeros((3, len(table), 2 + 3 * len(pairs)))
    for axis in range(3):
        jacobian[axis, :, 0], jacobian[axis, :, 1] = table[:, 7 + axis], table[:, 10 + axis]
        jacobian[axis, np.arange(len(table)), 2 + 3 * pair_of + axis] = 1.0
    return _Means(table[:, 0], table[:, 1:4], table[:, 13], pair_of, table[:, 4:7].T, jacobian)


def _kernels(means: _Means, steady_s: float) -> Array:
    """(4, n, n): covariance for a spread of one of each."""
    apart_s = np.abs(means.t[:, None] - means.t)
    apart_m = np.linalg.norm(means.place[:, None] - means.place, axis=2)
    same = means.pair[:, None] == means.pair
    fading = np.exp(-apart_s / steady_s)
    # the constant makes it a covariance; the free shifts make its value indifferent
    walk = (
        np.ptp(means.t)
        + 2.0 * steady_s
        - 0.5 * apart_s
        - (0.75 * steady_s + 0.25 * apart_s) * fading
    )
    return np.stack([
        np.diag(1.0 / means.count),
        same * (1.0 + apart_s / steady_s) * fading,
        same * walk,
        np.exp(-0.5 * (apart_m / WARP_LENGTH_M) ** 2),
    ])  # fmt: skip


@frozen
class _Solution:
    """Generalised least squares for one set of spreads.

    Attributes:
        likelihood: logarithm of the restricted one, up to a constant.
        unknowns, covariance: (u,), (u, u).
        inverse: (n, n), of the residuals' covariance, the same for all axes.
        gains: (3, n, u), inverse times Jacobian. left: (3, n), inverse times the residuals after
            the fit.
    """

    likelihood: float
    unknowns: Array
    covariance: Array
    inverse: Array
    gains: Array
    left: Array

    def projected(self, vectors: Array) -> Array:
        """(3, n) by the inverse, without what the unknowns explain."""
        fitted = self.covariance @ np.einsum("anu,an->u", self.gains, vectors)
        return vectors @ self.inverse - self.gains @ fitted


def _solution(
    spreads: Array,
    kernels: Array,
    means: _Means,
) -> _Solution:
    """``spreads``: logarithms of the four variances. Raises LinAlgError: something cannot be told
    at all.
    """
    covariance = np.tensordot(np.exp(spreads), kernels, 1)
    inverse = np.linalg.inv(covariance)
    gains = inverse @ means.jacobian
    normal = np.einsum("anu,anv->uv", means.jacobian, gains)
    scale = np.sqrt(np.diag(normal))
    if not np.all(scale > 0.0) or np.linalg.cond(normal / np.outer(scale, scale)) > 1e12:
        raise np.linalg.LinAlgError("singular")
    of_unknowns = np.linalg.inv(normal)
    unknowns = of_unknowns @ np.einsum("anu,an->u", gains, means.residual)
    left = means.residual @ inverse - gains @ unknowns
    logs = 3.0 * np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(normal)[1]
    likelihood = -0.5 * float(logs + np.sum(means.residual * left))
    return _Solution(likelihood, unknowns, of_unknowns, inverse, gains, left)


def _likeliest(
    spreads: Array,
    kernels: Array,
    means: _Means,
) -> tuple[Array, _Solution]:
    """Steps by average information, damped (Levenberg) so that none makes the records less
    likely.
    """
    now = _solution(spreads, kernels, means)
    damping = 1e-3
    for _ in range(SEARCH_STEPS):
        gradient, information = _slopes(now, spreads, kernels)
        better = None
        while better is None and damping < 1e6:
            damped = information + damping * np.diag(np.diag(information) + 1e-3)
            step = np.clip(np.linalg.solve(damped, gradient), -MOST_CHANGE, MOST_CHANGE)
            tried = np.maximum(spreads + step, 2.0 * math.log(LEAST_M))
            then = _solution(tried, kernels, means)
            if then.likelihood >= now.likelihood - 1e-9:
                better = tried, then
            damping *= 0.2 if better is not None else 10.0
        if better is None:
            break
        change = float(np.abs(better[0] - spreads).max())
        spreads, now = better
        damping = max(damping, 1e-6)
        if change < 0.01:
            break
    return spreads, now


def _slopes(
    now: _Solution,
    spreads: Array,
    kernels: Array,
) -> tuple[Array, Array]:
    """Gradient (4,) of the likelihood by the logarithms of the variances, and average information
    (4, 4).
    """
    variances = np.exp(spreads)
    seen = 3.0 * now.inverse - np.einsum(
        "anu,uv,amv->nm",
        now.gains,
        now.covariance,
        now.gains,
        optimize=True,
    )
    pulls = [now.left @ kernel for kernel in kernels]
    gradient = np.array([
        0.5 * v * (np.sum(now.left * pull) - np.sum(seen * kernel))
        for v, pull, kernel in zip(variances, pulls, kernels, strict=True)
    ])  # fmt: skip
    answers = [now.projected(pull) for pull in pulls]
    information = np.array([[np.sum(pull * answer) for answer in answers] for pull in pulls])
    return gradient, 0.5 * np.outer(variances, variances) * information
