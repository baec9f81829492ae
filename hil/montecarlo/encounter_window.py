"""The paper's gate, compiled: to know when an encounter may end. ``path.window`` itself is told afterwards."""

# pyright: reportMissingParameterType=false

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hil.geometric.kernels import kernel

# The window: pairs, first pair (D2's and D1's stamp), last pair, newest frame of D2 and D1, floor.
COUNT, FIRST, LAST, PEER, OWN, FLOOR = 0, 1, 3, 5, 6, 7
WINDOW_SIZE = 8
NEVER = -(1 << 62)
SLACK_NS = 500_000_000  # what was captured is judged later, by the link and both cycles


class Hold(NamedTuple):
    """The paper's gate: thresholds and how long; ``mapping`` 0 for the box's centre, 1 for its corner."""

    tau_min: float
    tau_max: float
    z0_m: float
    frames: int
    hold_ns: int
    max_gap_ns: int
    mapping: int


def fresh_window() -> np.ndarray:
    window = np.zeros(WINDOW_SIZE, np.int64)
    window[PEER] = window[OWN] = window[FLOOR] = NEVER
    return window


@kernel
def threshold(z, tau_min, tau_max, z0):
    scale = z0 / z
    return tau_min + (tau_max - tau_min) * min(1.0, scale * scale)


@kernel
def count(window, hold, agrees, number, capture, own):
    """``AgreementWindow.agree`` or ``disagree`` for a new frame of D2."""
    if number <= window[PEER]:
        return
    window[PEER] = number
    if not agrees:
        restart(window, capture)
        return
    if capture <= window[FLOOR]:
        return
    frame, stamp = own[0], own[1]
    if window[OWN] >= frame:
        frame, stamp = own[2], own[3]
        if frame <= window[OWN]:
            return
    expire(window, capture, hold.max_gap_ns)
    window[OWN] = frame
    window[FLOOR] = window[LAST] = capture
    window[LAST + 1] = stamp
    if window[COUNT] == 0:
        window[FIRST], window[FIRST + 1] = capture, stamp
    window[COUNT] += 1


@kernel
def complete(window, hold):
    span = min(window[LAST] - window[FIRST], window[LAST + 1] - window[FIRST + 1])
    return window[COUNT] >= hold.frames and span >= hold.hold_ns


@kernel
def hopeless(window, hold, now, limit):
    """Whether no run can be long enough before ``limit``: not even one that goes on, or begins now."""
    begin = window[FIRST] if window[COUNT] else now
    return begin - SLACK_NS + hold.hold_ns > limit


@kernel
def restart(window, stamp):
    window[COUNT] = 0
    window[FLOOR] = max(window[FLOOR], stamp)


@kernel
def expire(window, instant, max_gap):
    if window[COUNT] and instant - window[LAST] > max_gap:
        window[COUNT] = 0
