"""Thresholds, window length and box mapping tried on recorded series: many settings at once.

The window's rules are those of ``path.gate.window.AgreementWindow``, told as ``flight.harness.montecarlo.tell`` tells
it; a test holds the decisions together.
"""

# pyright: reportMissingParameterType=false

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from itertools import product

import numpy as np
from numba import njit
from numpy.typing import NDArray

from flight.harness.montecarlo import OWN_MISS, PAIR, Series
from path.config import BoxMapping, MethodConfig
from path.gate.window import SERIAL

Array = NDArray[np.float64]

MAPPINGS: tuple[BoxMapping, BoxMapping] = ("center", "corner")
TAUS = tuple(round(0.20 + 0.05 * k, 2) for k in range(11))
Z0S_M = (1.0, 1.5, 2.0, 3.0)
FRAMES = (25, 50, 100, 175, 250, 350)
HOLD_HZ = 50.0  # a window of n pairs also lasts n / 50 s
BINS = 100  # of the overlap, 0..1
NO_COMMIT, RIGHT, WRONG = 0, 1, 2
NEVER = -(1 << 62)


@dataclass(frozen=True, slots=True)
class Setting:
    """One point of the grid."""

    mapping: BoxMapping
    tau_min: float
    tau_max: float
    z0_m: float

    @classmethod
    def of(cls, method: MethodConfig) -> Setting:
        return cls(method.box_mapping, method.tau_min, method.tau_max, method.z0_m)

    def method(self, base: MethodConfig, frames: int) -> MethodConfig:
        return replace(
            base, box_mapping=self.mapping, tau_min=self.tau_min, tau_max=self.tau_max, z0_m=self.z0_m,
            gate="count", hold_frames=frames, hold_s=frames / HOLD_HZ,
        )  # fmt: skip


@cache
def grid() -> tuple[Setting, ...]:
    """All of them; z0 means nothing where both thresholds are the same."""
    default = Setting.of(MethodConfig())
    settings = [
        Setting(mapping, low, high, z0)
        for mapping, low, high, z0 in product(MAPPINGS, TAUS, TAUS, Z0S_M)
        if high > low or (high == low and z0 == Z0S_M[0])
    ]
    return tuple(settings if default in settings else [*settings, default])


@dataclass(frozen=True, slots=True)
class Outcomes:
    """The outcomes of an attempt by setting.

    Attributes:
        commit: (settings, FRAMES) NO_COMMIT, RIGHT or WRONG.
        pairs: (2, 2, BINS) compared pairs by object (the wrong one, the right one), mapping and overlap.
    """

    commit: NDArray[np.int8]
    pairs: NDArray[np.int64]


def outcomes(series: Series, method: MethodConfig) -> Outcomes:
    """Every setting of the grid, with every window length, on one series."""
    usable = (series.kind == PAIR) & (series.pose_sigma_m <= method.max_pose_sigma_m)
    commit = np.zeros((len(grid()), len(FRAMES)), np.int8)
    frames = np.array(FRAMES)
    _decide(
        series.kind, usable, series.now_ns, series.sequence, series.capture_ns, series.own, series.iou, series.z_m,
        series.right, _rows(), frames, np.rint(frames / HOLD_HZ * 1e9).astype(np.int64),
        round(method.max_gap_s * 1e9), commit,
    )  # fmt: skip
    return Outcomes(commit, _counted(series, usable))


def _counted(series: Series, usable: NDArray[np.bool_]) -> NDArray[np.int64]:
    bins = np.clip((np.nan_to_num(series.iou) * BINS).astype(int), 0, BINS - 1)
    return np.array(
        [
            [np.bincount(bins[usable & (series.right == right), k], minlength=BINS) for k in range(len(MAPPINGS))]
            for right in (False, True)
        ]
    )


@cache
def _rows() -> Array:
    return np.array([(MAPPINGS.index(s.mapping), s.tau_min, s.tau_max, s.z0_m) for s in grid()], float)


# The window: pairs of the run; newest frames of D2 and D1 and the instant before which nothing counts; first and last
# pair, as D2's and as D1's stamp.
_COUNT, _PEER, _OWN, _FLOOR, _FIRST, _LAST = 0, 1, 2, 3, 4, 6


@njit(cache=True, nogil=True)
def _decide(kind, usable, now, sequence, capture, own, iou, z, right, settings, frames, hold, max_gap, commit):
    """Fill ``commit``: the settings one after the other, all window lengths together."""
    window = np.empty(8, np.int64)
    for row in range(settings.shape[0]):
        mapping, low, high, z0 = int(settings[row, 0]), settings[row, 1], settings[row, 2], settings[row, 3]
        window[:] = 0
        window[_PEER] = window[_OWN] = window[_FLOOR] = NEVER
        newest = False  # whether the newest pair that counted is right
        for k in range(kind.size):
            if k > 0 and now[k] != now[k - 1]:  # D1 looks once it has judged what came in
                _look(window, frames, hold, newest, commit[row])
            if kind[k] == OWN_MISS:
                window[_COUNT], window[_FLOOR] = 0, max(window[_FLOOR], capture[k])
                continue
            tau = low + (high - low) * min(1.0, (z0 / z[k]) ** 2) if usable[k] else np.inf
            if _tell(window, iou[k, mapping] >= tau, sequence[k], capture[k], own[k], max_gap):
                newest = right[k]
        if kind.size:
            _look(window, frames, hold, newest, commit[row])


@njit(cache=True, nogil=True)
def _look(window, frames, hold, right, commit):
    span = min(window[_LAST] - window[_FIRST], window[_LAST + 1] - window[_FIRST + 1])
    for n in range(frames.size):
        if commit[n] == NO_COMMIT and window[_COUNT] >= frames[n] and span >= hold[n]:
            commit[n] = RIGHT if right else WRONG


@njit(cache=True, nogil=True)
def _tell(window, agrees, sequence, capture, own, max_gap):
    """A frame of D2: ``AgreementWindow.expire``, then ``agree`` or ``disagree``. Returns whether it counts."""
    if window[_COUNT] > 0 and capture - window[_LAST] > max_gap:
        window[_COUNT] = 0
    number = sequence
    if window[_PEER] != NEVER:
        number = window[_PEER] + (sequence - window[_PEER] + SERIAL // 2) % SERIAL - SERIAL // 2
    if number <= window[_PEER]:
        return False
    window[_PEER] = number
    if not agrees:
        window[_COUNT], window[_FLOOR] = 0, max(window[_FLOOR], capture)
        return False
    first = 0 if own[0] > window[_OWN] else 2
    if capture <= window[_FLOOR] or own[first] <= window[_OWN]:
        return False
    window[_OWN], window[_FLOOR] = own[first], capture
    window[_LAST], window[_LAST + 1] = capture, own[first + 1]
    if window[_COUNT] == 0:
        window[_FIRST], window[_FIRST + 1] = window[_LAST], window[_LAST + 1]
    window[_COUNT] += 1
    return True
