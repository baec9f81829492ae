"""The figures of a recorded stretch of flight: pure functions of its instants. Heights and speeds
are true ones.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from drivers.interfaces import FlightMode
from drivers.mavlink.bench import HeartbeatShown, Instant
from path.arrays import Array, Flags
from path.geometry.rotation import conjugate, multiply, wrapped, yaw_of
from path.values import frozen

AIRBORNE_M = 0.05
LANDED_STATES = ("undefined", "on ground", "in air", "take-off", "landing")  # MAV_LANDED_STATE


@frozen(eq=False)
class FlightTrack:
    """Arrays over time: ``t`` (n,), ``height`` (n,), ``position`` and ``velocity`` (n, 3) NED,
    ``yaw`` (n,).
    """

    t: Array
    height: Array
    position: Array
    velocity: Array
    yaw: Array

    @classmethod
    def of(
        cls,
        instants: Sequence[Instant],
        start_s: float,
        end_s: float = math.inf,
    ) -> FlightTrack:
        own = [each for each in instants if start_s <= each.time_s <= end_s]
        return cls(
            np.array([each.time_s for each in own]),
            np.array([each.height_m for each in own]),
            np.array([each.position_n_m for each in own]).reshape(-1, 3),
            np.array([each.velocity_n_mps for each in own]).reshape(-1, 3),
            np.unwrap(np.array([yaw_of(each.q_n_b) for each in own])),
        )


def first(
    t: Array,
    holds: Flags,
    from_s: float,
) -> float | None:
    """Seconds from ``from_s`` until the first sample for which it holds; None when it never
    does.
    """
    found = np.flatnonzero(holds & (t >= from_s))
    return float(t[found[0]] - from_s) if len(found) else None


def fastest_mps(
    t: Array,
    values: Array,
    window_s: float = 0.5,
) -> float | None:
    """Steepest slope of ``values`` over any window."""
    later = np.searchsorted(t, t + window_s)
    whole = later < len(t)
    if not whole.any():
        return None
    rise = values[later[whole]] - values[whole]
    return float(np.max(rise / (t[later[whole]] - t[whole])))


@frozen
class Response:
    """The response to a step of a speed: seconds to 63 % of it, largest excess in percent, error
    once settled.
    """

    rise_s: float | None
    overshoot_percent: float
    error_mps: float


def response(
    t: Array,
    speed: Array,
    from_s: float,
    wanted_mps: float,
) -> Response:
    """``speed`` in the direction of the step; the last second counts as settled."""
    rise_s = first(t, speed >= 0.632 * wanted_mps, from_s)
    settled = speed[t >= t[-1] - 1.0]
    excess = 100.0 * (float(np.max(speed)) / wanted_mps - 1.0)
    return Response(rise_s, max(0.0, excess), float(np.mean(settled)) - wanted_mps)


def standing(
    track: FlightTrack,
    from_s: float,
    slow_mps: float = 0.2,
) -> tuple[float | None, float | None]:
    """Seconds and metres from a moment until the horizontal speed was first below ``slow_mps``."""
    speed = np.hypot(track.velocity[:, 0], track.velocity[:, 1])
    after_s = first(track.t, speed < slow_mps, from_s)
    if after_s is None:
        return None, None
    begin = track.position[np.searchsorted(track.t, from_s)]
    end = track.position[np.searchsorted(track.t, from_s + after_s)]
    return after_s, float(np.hypot(*(end - begin)[:2]))


def estimate_errors(instants: Sequence[Instant]) -> dict[str, float]:
    """The estimate that the driver tells, against the truth of the same moments: mean and standard
    deviation.

    Only of a hovering vehicle: what the telemetry is late by would count as an error of one that
    moves.
    """
    own = [
        (each, each.said) for each in instants if each.said is not None and each.said.stamp_ns > 0
    ]
    position = np.array([np.subtract(said.position_n_m, each.position_n_m) for each, said in own])
    velocity = np.array(
        [np.subtract(said.velocity_n_mps, each.velocity_n_mps) for each, said in own]
    )
    yaw = np.array([wrapped(yaw_of(said.q_n_b) - yaw_of(each.q_n_b)) for each, said in own])
    tilt = np.array([_tilt(multiply(conjugate(each.q_n_b), said.q_n_b)) for each, said in own])
    return {
        "across_bias_m": float(np.hypot(*position[:, :2].mean(axis=0))),
        "across_std_m": float(np.hypot(*position[:, :2].std(axis=0))),
        "height_bias_m": float(-position[:, 2].mean()),
        "height_std_m": float(position[:, 2].std()),
        "velocity_std_mps": float(np.hypot(*velocity[:, :2].std(axis=0))),
        "climb_std_mps": float(velocity[:, 2].std()),
        "tilt_rms_deg": float(np.degrees(np.sqrt(np.mean(tilt**2)))),
        "yaw_bias_deg": float(np.degrees(yaw.mean())),
        "yaw_std_deg": float(np.degrees(yaw.std())),
    }


def _tilt(q: tuple[float, float, float, float]) -> float:
    """Angle in rad between two verticals, of the rotation between the frames they are in."""
    w, x, y, z = q
    return math.acos(max(-1.0, min(1.0, w * w - x * x - y * y + z * z)))


def modes_since(shown: Sequence[HeartbeatShown], from_s: float) -> list[tuple[float, str]]:
    """(seconds after ``from_s``, mode or "disarmed") of every change that the heartbeats showed."""
    before = [each for each in shown if each.time_s <= from_s]
    last = _named(before[-1]) if before else ""
    changes: list[tuple[float, str]] = []
    for each in shown:
        if each.time_s > from_s and _named(each) != last:
            last = _named(each)
            changes.append((each.time_s - from_s, last))
    return changes


def _named(shown: HeartbeatShown) -> str:
    if not shown.armed:
        return "disarmed"
    return (
        shown.mode.value if shown.mode is not FlightMode.OTHER else f"mode {shown.custom_mode:#x}"
    )


def in_words(changes: Sequence[tuple[float, str]]) -> str:
    return " → ".join(name for _, name in changes) or "no change"


def when(changes: Sequence[tuple[float, str]], name: str) -> float | None:
    """Return when it first showed ``name``; None when it never did."""
    return next((time_s for time_s, shown in changes if shown == name), None)


def landed_since(
    landed: Sequence[tuple[float, int]],
    from_s: float,
    end_s: float,
) -> list[tuple[float, str]]:
    """(seconds after ``from_s``, landed state) of every change, with the one at the start."""
    changes: list[tuple[float, str]] = []
    for time_s, state in landed:
        name = LANDED_STATES[state] if state < len(LANDED_STATES) else str(state)
        if from_s - 1.0 < time_s <= end_s and (not changes or changes[-1][1] != name):
            changes.append((max(0.0, time_s - from_s), name))
    return changes


def rate_hz(
    arrivals_s: Sequence[float],
    start_s: float,
    end_s: float,
) -> float:
    count = sum(start_s <= each <= end_s for each in arrivals_s)
    return count / (end_s - start_s)


def longest_gap_s(
    arrivals_s: Sequence[float],
    start_s: float,
    end_s: float,
) -> float | None:
    own = [each for each in arrivals_s if start_s <= each <= end_s]
    return max((b - a for a, b in pairwise(own)), default=None)
