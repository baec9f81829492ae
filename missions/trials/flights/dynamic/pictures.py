"""Figures of the dynamic trial."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from missions.look.report.palette import COUNT, DIM, FAULT, NEEDED, ROLE
from missions.trials.flights.dynamic.judge import (
    SUBJECTS,
    Compared,
    HarnessVerdict,
    SessionErrors,
    pairs_of,
)
from missions.trials.shared.drawing import panels, save, sheet
from missions.trials.shared.statistics import rms
from path.arrays import Array
from path.messages import Role

COLORS = {"sender": ROLE[Role.SENDER], "receiver": ROLE[Role.RECEIVER], "target": COUNT}
LABELS = {"sender": "D1", "receiver": "D2", "target": "target"}
OF = {"d2": "receiver", "target": "target"}


def draw_map(
    judged: SessionErrors,
    file: Path,
    true_place: Callable[[str, Array], Array] | None = None,
) -> None:
    """Draw from above what beacons and PATH say, in the beacons' frame and around D1.

    Args:
        true_place: where a body truly was in the beacons' frame, (n, 3), at instants of the
            receiver's clock.
    """
    figure, (left, right) = panels(13.0, 6.2, columns=2)
    t = np.arange(judged.motions.d2.t[0], judged.motions.d2.t[-1], 0.05)
    for name, path in judged.heard.paths.items():
        near = (path.t + judged.clock.offset_s >= t[0]) & (path.t + judged.clock.offset_s <= t[-1])
        left.plot(*path.p[near, :2].T, ".", ms=3, color=COLORS[name], alpha=0.45)
        if true_place is not None:
            left.plot(*true_place(name, t)[:, :2].T, color=NEEDED, lw=0.8)
    d1 = judged.motions.own_1.at(t) @ judged.clock.R.T + judged.clock.shifts[1]
    left.plot(*d1[:, :2].T, color=COLORS["sender"], lw=1.8, label="D1, own estimate")
    for k, name in enumerate(SUBJECTS):
        curve = judged.motions.d2 if name == "d2" else judged.motions.target
        seen = curve.at(t) @ judged.frame.R.T
        place = d1 + seen + judged.frame.shifts[k]
        left.plot(
            *place[:, :2].T,
            color=COLORS[OF[name]],
            lw=1.8,
            label=f"{LABELS[OF[name]]}, PATH from there",
        )
    left.plot([], [], ".", color=DIM, label="beacons")
    if true_place is not None:
        left.plot([], [], color=NEEDED, lw=0.8, label="truth")
    left.set_title("In the beacons' frame, while D2 saw the marker", loc="left", fontsize=10)
    pairs, _ = pairs_of(judged.motions, judged.heard)
    for k, (name, pair) in enumerate(zip(SUBJECTS, pairs, strict=True)):
        used = judged.frame.used[k]
        right.plot(*pair.samples.p[used, :2].T, ".", ms=4, color=COLORS[OF[name]], alpha=0.45)
        seen = pair.curve.p @ judged.frame.R.T + judged.frame.shifts[k]
        right.plot(
            *seen[:, :2].T,
            color=COLORS[OF[name]],
            lw=1.5,
            label=f"{LABELS[OF[name]]}, PATH",
        )
    right.plot(0.0, 0.0, "s", color=COLORS["sender"], label="D1")
    right.set_title("From D1 (axes of the beacons' frame)", loc="left", fontsize=10)
    for axes in (left, right):
        axes.set_aspect("equal", "datalim")
        axes.set_xlabel("x, m")
        axes.set_ylabel("y, m")
        axes.legend(fontsize=8)
        axes.grid(alpha=0.3)
    save(figure, file)


def draw_errors(
    judged: SessionErrors,
    file: Path,
    truth: Mapping[str, Compared] | None = None,
) -> None:
    """Errors over time of both trajectories, against the beacons and, where it is known, the
    truth.
    """
    figure = sheet(11.0, 6.0)
    start = float(judged.motions.d2.t[0])
    for axes, name in zip(np.atleast_1d(figure.subplots(2, 1, sharex=True)), SUBJECTS, strict=True):
        _draw_error(axes, judged.beacons[name], None if truth is None else truth[name], name, start)
    figure.axes[-1].set_xlabel("s since the marker was first seen")
    save(figure, file)


def _draw_error(
    axes: Axes,
    beacons: Compared,
    truth: Compared | None,
    name: str,
    start_s: float,
) -> None:
    color = COLORS[OF[name]]
    axes.plot(
        beacons.t - start_s,
        1e3 * beacons.error_m,
        ".",
        ms=4,
        color=DIM,
        label="against the beacons",
    )
    axes.axhline(
        1e3 * beacons.expected_m,
        color=FAULT,
        lw=1.0,
        ls="--",
        label="rms from the beacons' noise alone",
    )
    if truth is not None:
        axes.plot(
            truth.t - start_s,
            1e3 * truth.error_m,
            ".",
            ms=2,
            color=color,
            label="against the truth",
        )
    axes.set_yscale("log")
    axes.set_ylim(0.1, 300.0)
    axes.set_ylabel("mm")
    axes.set_title(f"{LABELS[OF[name]]} from D1", loc="left", fontsize=10)
    axes.legend(fontsize=8, loc="lower right", ncols=3)
    axes.grid(alpha=0.3, which="both")


def draw_coast(judged: Sequence[HarnessVerdict], file: Path) -> None:
    """Errors of the predicted position and what is claimed, by the time without a marker."""
    figure, (axes,) = panels(8.0, 4.8)
    unseen = np.concatenate([each.coasts.unseen_s for each in judged])
    error_m = np.concatenate([np.linalg.norm(each.coasts.error[:, :3], axis=1) for each in judged])
    sigma_m = np.concatenate([each.coasts.sigma_m for each in judged])
    axes.plot(unseen, 1e3 * error_m, ".", ms=3, color=DIM, alpha=0.4, label="each gap")
    at = np.arange(0.0, 1.01, 0.1)
    near = [np.abs(unseen - each) < 0.011 for each in at]
    axes.plot(
        at,
        [1e3 * rms(error_m[where]) for where in near],
        "o-",
        color=ROLE[Role.RECEIVER],
        label="error, rms",
    )
    axes.plot(
        at,
        [1e3 * rms(sigma_m[where]) for where in near],
        "--",
        color=NEEDED,
        label="claimed sigma",
    )
    axes.set_xlabel("s without a marker")
    axes.set_ylabel("position of the marker, mm")
    axes.set_ylim(0.0, None)
    axes.grid(alpha=0.3)
    axes.legend()
    save(figure, file)
