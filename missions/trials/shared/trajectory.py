"""Two records of one motion: how their clocks and frames lie to each other, and how far they are
apart then.

A *curve* is a motion by an own clock and in an own frame; *samples* are positions of the same
motion by another clock and in another frame. With an offset ``d`` and a transform between the
frames, a sample at ``t`` is ``R c(t + d) + shift``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Literal

import numpy as np

from path.arrays import Array, Flags, Whole
from path.geometry.rotation import exp
from path.target.kernels import MAD_TO_SIGMA
from path.values import frozen

Turn = Literal["vertical", "any"]

SLOPE_S = 0.06  # to either side, for the velocity of a curve
GRID_S = 0.1  # of the coarse search for the offset
BASE_S = 1.0  # over which speeds are compared there
MIN_OVERLAP = 0.5
ITERATIONS = 30
RIDGE = 1e-10  # of a normal equation's diagonal
# robust deviations from where a residual counts less, and not at all
HUBER = 1.5
REJECT = 4.0
BLOCK_S = 2.0  # residuals nearer in time than this are taken together
RESAMPLES = 200


@frozen
class Trajectory:
    """Positions (n, 3) in m at increasing instants (n,) in s."""

    t: Array
    p: Array

    def at(self, t: Array, max_gap_s: float = 0.3) -> Array:
        """Positions at instants, (m, 3), linear between neighbours; NaN outside and in gaps."""
        after = np.clip(np.searchsorted(self.t, t), 1, len(self.t) - 1)
        t0 = self.t[after - 1]
        t1 = self.t[after]
        share = ((t - t0) / (t1 - t0))[:, None]
        found = (1.0 - share) * self.p[after - 1] + share * self.p[after]
        found[(t < self.t[0]) | (t > self.t[-1]) | (t1 - t0 > max_gap_s)] = np.nan
        return found

    def velocity_at(self, t: Array) -> Array:
        """(m, 3), NaN where it is not known."""
        return (self.at(t + SLOPE_S) - self.at(t - SLOPE_S)) / (2.0 * SLOPE_S)


@frozen
class MotionPair:
    """One motion in both records.

    ``wander_s``: the curve drifts, its shift changes from one such time to the next, linearly
    between; None: never.
    """

    curve: Trajectory
    samples: Trajectory
    wander_s: float | None = None


@frozen
class Alignment:
    """The alignment of samples with curves; standard deviations are from a bootstrap over blocks of
    time.

    Attributes:
        offset_s: add it to a sample's stamp to get the curve's.
        R: (3, 3), common to all pairs; ``yaw_rad`` is its turn about the vertical.
        shifts: (3,) of each pair, the mean of one that wanders.
        shift_sigma_m: per axis, of each pair.
        residuals: of each pair, curve minus samples in the samples' frame, (n, 3); NaN where the
            curve is not known.
        used: of each pair, the samples (bool) that no outlier test refused.
        scales_m: of each pair, robust standard deviation of a residual per axis.
    """

    offset_s: float
    R: Array
    shifts: tuple[Array, ...]
    yaw_rad: float
    offset_sigma_s: float
    yaw_sigma_rad: float
    shift_sigma_m: tuple[float, ...]
    residuals: tuple[Array, ...]
    used: tuple[Flags, ...]
    scales_m: tuple[float, ...]


def coarse_offset(curve: Trajectory, samples: Trajectory) -> float:
    """Offset at which the speeds fit best, to a tenth of a second or so. Neither frame matters.

    Raises:
        ValueError: they are too short to be compared.
    """
    a_start, a = _speeds(curve)
    b_start, b = _speeds(samples)
    least = round(MIN_OVERLAP * min(len(a), len(b)))
    if least < 2.0 / GRID_S:
        raise ValueError("too short to find the offset between two clocks")
    best = 0
    best_cost = math.inf
    for lag in range(least - len(b), len(a) - least + 1):
        x = a[max(0, lag) : lag + len(b)]
        y = b[max(0, -lag) :]
        n = min(len(x), len(y))
        cost = float(np.nanmean((x[:n] - y[:n]) ** 2)) / max(
            float(np.nanvar(x[:n])) + float(np.nanvar(y[:n])), 1e-9
        )
        if cost < best_cost:
            best = lag
            best_cost = cost
    return a_start + best * GRID_S - b_start


def _speeds(motion: Trajectory) -> tuple[float, Array]:
    """Start, and mean speed over ``BASE_S`` on a grid; the middle of three, against single wrong
    positions.
    """
    if len(motion.t) < 3:
        return 0.0, np.zeros(0)
    middle = motion.p.copy()
    middle[1:-1] = np.median(np.stack([motion.p[:-2], motion.p[1:-1], motion.p[2:]]), axis=0)
    smooth = Trajectory(motion.t, middle)
    grid = np.arange(motion.t[0] + 0.5 * BASE_S, motion.t[-1] - 0.5 * BASE_S, GRID_S)
    moved = smooth.at(grid + 0.5 * BASE_S, 2.0) - smooth.at(grid - 0.5 * BASE_S, 2.0)
    return float(grid[0]) if len(grid) else 0.0, np.linalg.norm(moved, axis=1) / BASE_S


def align(
    pairs: Sequence[MotionPair],
    offset_s: float,
    rng: np.random.Generator,
    *,
    fit_offset: bool = True,
    turn: Turn = "vertical",
) -> Alignment:
    """Offset, rotation and shifts by robust least squares over continuous time, without scale.

    Args:
        pairs: one offset and one rotation for all, a shift for each; each counts by its own spread.
        offset_s: a guess good to some tenths of a second; kept as it is without ``fit_offset``.
        turn: what the rotation may be.

    Raises:
        ValueError: fewer than ten samples of a pair lie on its curve.
    """
    problem = _Problem(pairs, fit_offset, turn)
    state = problem.start(offset_s)
    for _ in range(ITERATIONS):
        residuals, jacobian, known = problem.linearized(state)
        weights, _ = problem.weights(residuals, known)
        before = state
        state = problem.stepped(state, residuals, jacobian, weights)
        if (
            abs(state.offset_s - before.offset_s) < 1e-7
            and float(np.abs(state.R - before.R).max()) < 1e-9
        ):
            break
    residuals, jacobian, known = problem.linearized(state)
    weights, scales = problem.weights(residuals, known)
    tried = problem.resampled(state, residuals, jacobian, weights, rng)
    means = np.array([[shift.mean(axis=0) for shift in other.shifts] for other in tried])
    return Alignment(
        offset_s=state.offset_s,
        R=state.R,
        shifts=tuple(shift.mean(axis=0) for shift in state.shifts),
        yaw_rad=_yaw(state.R),
        offset_sigma_s=float(np.std([other.offset_s for other in tried])),
        yaw_sigma_rad=float(np.std([_yaw(other.R @ state.R.T) for other in tried])),
        shift_sigma_m=tuple(np.sqrt(np.mean(np.var(means, axis=0), axis=1)).tolist()),
        residuals=tuple(
            np.where(known[part, None], residuals[part], np.nan) for part in problem.parts
        ),
        used=tuple(weights[part] > 0.0 for part in problem.parts),
        scales_m=scales,
    )


@frozen
class _TrajectoryFit:
    """``shifts``: (knots, 3) of each pair."""

    offset_s: float
    R: Array
    shifts: tuple[Array, ...]


class _Problem:
    """Residuals of all pairs, stacked: unknown are the offset, the rotation vector, and the shifts
    of each pair.
    """

    def __init__(self, pairs: Sequence[MotionPair], fit_offset: bool, turn: Turn) -> None:
        self._pairs = pairs
        self._axes = np.eye(3)[2:] if turn == "vertical" else np.eye(3)
        self._fit_offset = fit_offset
        self._turn: Turn = turn
        self.parts = [
            slice(int(a), int(b))
            for a, b in pairwise(np.cumsum([0, *(len(p.samples.t) for p in pairs)]))
        ]
        t = np.concatenate([pair.samples.t for pair in pairs])
        # what wanders is alike for as long
        self.blocks = blocks_of(
            t, max([BLOCK_S, *(pair.wander_s for pair in pairs if pair.wander_s is not None)])
        )
        self._hats = [_hats(pair.samples.t, pair.wander_s) for pair in pairs]
        first = 1 + len(self._axes)
        self._columns = [
            slice(int(a), int(b))
            for a, b in pairwise(
                first + np.cumsum([0, *(3 * hats.shape[1] for hats in self._hats)])
            )
        ]

    def start(self, offset_s: float) -> _TrajectoryFit:
        """Closed form at the guessed offset (Umeyama without scale); outliers are still in, few,
        and within metres.

        Shifts are medians of what is left, by then in one frame: medians of each record's own
        places turn with the frame that they are taken in, and a pair that starts wrong by that is
        refused as a whole and stays so.
        """
        together = list[tuple[Array, Array]]()
        for pair in self._pairs:
            x = pair.curve.at(pair.samples.t + offset_s)
            known = np.isfinite(x[:, 0])
            if np.count_nonzero(known) < 10:
                raise ValueError("too few samples lie on the curve")
            together.append((x[known], pair.samples.p[known]))
        a, b = (
            np.concatenate([own - own.mean(axis=0) for own in side])
            for side in zip(*together, strict=True)
        )
        R = rotation_between(a, b, self._turn)
        shifts = (np.median(y - x @ R.T, axis=0) for x, y in together)
        return _TrajectoryFit(
            offset_s,
            R,
            tuple(
                np.tile(shift, (hats.shape[1], 1))
                for shift, hats in zip(shifts, self._hats, strict=True)
            ),
        )

    def linearized(self, state: _TrajectoryFit) -> tuple[Array, Array, Flags]:
        """Residuals (n, 3), Jacobian (n, 3, unknowns), and which samples lie on their curve."""
        count = self.parts[-1].stop
        residuals = np.zeros((count, 3))
        jacobian = np.zeros((count, 3, self._columns[-1].stop))
        known = np.zeros(count, bool)
        for k, pair in enumerate(self._pairs):
            where = self.parts[k]
            hats = self._hats[k]
            instants = pair.samples.t + state.offset_s
            placed = pair.curve.at(instants) @ state.R.T
            velocity = pair.curve.velocity_at(instants) @ state.R.T
            fine = np.isfinite(placed[:, 0]) & np.isfinite(velocity[:, 0])
            known[where] = fine
            residuals[where] = np.where(
                fine[:, None], placed + hats @ state.shifts[k] - pair.samples.p, 0.0
            )
            part = jacobian[where]
            if self._fit_offset:
                part[:, :, 0] = np.where(fine[:, None], velocity, 0.0)
            for i, axis in enumerate(self._axes):
                part[:, :, 1 + i] = np.where(fine[:, None], np.cross(axis, placed), 0.0)
            for i in range(3):
                part[:, i, self._columns[k].start + i : self._columns[k].stop : 3] = hats
        return residuals, jacobian, known

    def weights(self, residuals: Array, known: Flags) -> tuple[Array, tuple[float, ...]]:
        """Robust weights (n,), zero for outliers and unknown ones, and the spread of each pair."""
        weights = np.zeros(len(residuals))
        scales = list[float]()
        for part in self.parts:
            own = residuals[part]
            scales.append(_scale(own[known[part]]))
            weights[part] = np.where(known[part], huber(own, scales[-1]) / scales[-1] ** 2, 0.0)
        return weights, tuple(scales)

    def stepped(
        self, state: _TrajectoryFit, residuals: Array, jacobian: Array, weights: Array
    ) -> _TrajectoryFit:
        """One Gauss-Newton step."""
        rows = (jacobian * np.sqrt(weights)[:, None, None]).reshape(-1, jacobian.shape[2])
        return self._moved(
            state, rows.T @ rows, rows.T @ (residuals * np.sqrt(weights)[:, None]).ravel()
        )

    def resampled(
        self,
        state: _TrajectoryFit,
        residuals: Array,
        jacobian: Array,
        weights: Array,
        rng: np.random.Generator,
    ) -> list[_TrajectoryFit]:
        """Return where one step leads when each block of time counts as often as it is drawn.

        How sure the solution is.
        """
        blocks = [np.flatnonzero(self.blocks == block) for block in np.unique(self.blocks)]
        normals = list[Array]()
        gradients = list[Array]()
        for block in blocks:
            rows = (jacobian[block] * np.sqrt(weights[block])[:, None, None]).reshape(
                -1, jacobian.shape[2]
            )
            normals.append(rows.T @ rows)
            gradients.append(rows.T @ (residuals[block] * np.sqrt(weights[block])[:, None]).ravel())
        draws = (rng.integers(0, len(blocks), len(blocks)) for _ in range(RESAMPLES))
        return [
            self._moved(
                state,
                np.sum([normals[i] for i in draw], axis=0),
                np.sum([gradients[i] for i in draw], axis=0),
            )
            for draw in draws
        ]

    def _moved(self, state: _TrajectoryFit, normal: Array, gradient: Array) -> _TrajectoryFit:
        step = -_solved(normal, gradient)
        R = exp(self._axes.T @ step[1 : 1 + len(self._axes)]) @ state.R
        # small against the curve's own bends, so that the slope still holds
        offset_s = state.offset_s + float(np.clip(step[0], -0.3, 0.3))
        shifts = [
            shift + step[own].reshape(-1, 3)
            for shift, own in zip(state.shifts, self._columns, strict=True)
        ]
        return _TrajectoryFit(offset_s, R, tuple(shifts))


def _solved(normal: Array, gradient: Array) -> Array:
    """The step of the normal equations; what no sample says anything of (a knot in a gap) stays
    where it is.
    """
    scale = np.sqrt(np.diag(normal))
    scale[scale == 0.0] = 1.0
    scaled = normal / (scale[:, None] * scale) + RIDGE * np.eye(len(normal))
    return np.linalg.solve(scaled, gradient / scale) / scale


def _hats(t: Array, wander_s: float | None) -> Array:
    """Return each knot's share in the shift at an instant, (n, knots)."""
    if wander_s is None:
        return np.ones((len(t), 1))
    knots = max(2, 1 + round((t.max() - t.min()) / wander_s))
    place = (t - t.min()) / (t.max() - t.min()) * (knots - 1)
    return np.maximum(0.0, 1.0 - np.abs(place[:, None] - np.arange(knots)))


def rotation_between(a: Array, b: Array, turn: Turn) -> Array:
    """The rotation that takes vectors (n, 3) to others best; about z alone, or any (Umeyama)."""
    if turn == "vertical":
        angle = math.atan2(
            float(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])),
            float(np.sum(a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1])),
        )
        return exp(np.array([0.0, 0.0, angle]))
    u, _, v = np.linalg.svd(b.T @ a)
    return u @ np.diag([1.0, 1.0, float(np.sign(np.linalg.det(u @ v)))]) @ v


def _yaw(R: Array) -> float:
    return math.atan2(float(R[1, 0]), float(R[0, 0]))


def _scale(residuals: Array) -> float:
    """Robust standard deviation per axis."""
    if len(residuals) < 10:
        raise ValueError("too few samples lie on the curve")
    return MAD_TO_SIGMA * float(np.median(np.abs(residuals))) + 1e-9


def huber(residuals: Array, scale: float) -> Array:
    """Return the weight of each of the residuals (n, 3), (n,), by its length over a deviation per
    axis.
    """
    length = np.linalg.norm(residuals, axis=1) / (math.sqrt(3.0) * scale)
    return np.where(
        length < HUBER, 1.0, np.where(length < REJECT, HUBER / np.maximum(length, HUBER), 0.0)
    )


# --- how far apart


def ape(residuals: Array) -> Array:
    """Absolute pose errors (positions): lengths of residuals (n, 3)."""
    return np.linalg.norm(residuals, axis=1)


def rpe_after(t: Array, residuals: Array, after_s: float) -> Array:
    """Relative errors over a time: how the residuals (n, 3) at instants (n,) change; pairs within a
    fifth of it.
    """
    after = np.clip(np.searchsorted(t, t + after_s), 1, len(t) - 1)
    after -= np.abs(t[after - 1] - t - after_s) < np.abs(t[after] - t - after_s)
    fine = np.abs(t[after] - t - after_s) < 0.2 * after_s
    return np.linalg.norm(residuals[after[fine]] - residuals[fine], axis=1)


def rpe_along(places: Array, residuals: Array, along_m: float) -> Array:
    """Relative errors over a way along the motion itself, (n, 3) places."""
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1))])
    after = np.searchsorted(way, way + along_m)
    fine = after < len(way)
    return np.linalg.norm(residuals[after[fine]] - residuals[fine], axis=1)


def blocks_of(t: Array, block_s: float = BLOCK_S) -> Whole:
    """The block of time each instant is in: what is to be resampled together."""
    return ((t - t.min()) / block_s).astype(np.int64) if len(t) else np.zeros(0, np.int64)
