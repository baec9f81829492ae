"""The results of the static experiment as summary, findings and tables."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from flight.harness.errors import TrialErrors
from missions.trials.pose.static.methods import FLIPPED_RAD, METHODS, SETTINGS, Method, Results
from missions.trials.pose.static.shots import DEPTH, METHOD
from missions.trials.pose.static.stage import (
    CAMERA,
    CONFIGURATIONS,
    HOVER_M,
    HOVER_RAD,
    HOVER_YAW_RAD,
    SIDE_SIGMA_M,
)
from missions.trials.shared.statistics import RESAMPLES, Interval, wilson
from missions.trials.shared.trial import TrialFinding, TrialTable, verdict
from path.arrays import Array
from path.values import frozen

Statistic = Callable[[Array], Array]

GOAL_MEAN_M = 0.008
GOAL_P95_M = 0.015
DEFAULT: Method = "gravity_photometric"
METHOD_TITLES: dict[Method, str] = {
    "ippe": "first IPPE solution, SUBPIX corners",
    "gravity_subpix": "gravity, SUBPIX corners",
    "photometric": "photometric corners, no gravity",
    "gravity_photometric": "gravity, photometric corners (default)",
}
SEVEN = slice(0, len(CONFIGURATIONS))
FACING = [k for k, c in enumerate(CONFIGURATIONS) if c.facing]
SAME = [k for k, c in enumerate(CONFIGURATIONS) if not c.facing]
HEADLINE = "measured"
PIPELINES = {
    HEADLINE: "as measured on photographs of a D435, uncompressed",
    "ideal": "linear sensor, no compression",
    "realistic": "mosaic, gamma 2.2, sharpened, JPEG 90",
    "realistic_h264": "mosaic, gamma 2.2, sharpened, H.264 at CRF 23",
}


def mean(values: Array) -> Array:
    """Along the last axis, of what is there; NaN when nothing is."""
    there = ~np.isnan(values)
    total = np.where(there, values, 0.0).sum(axis=-1)
    count = there.sum(axis=-1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def percentile(values: Array, percent: float) -> Array:
    """Along the last axis, of what is there, interpolated linearly; NaN when nothing is."""
    ordered = np.sort(values, axis=-1)  # NaN last
    last = np.maximum((~np.isnan(values)).sum(axis=-1) - 1, 0)
    at = np.asarray(0.01 * percent * last)
    below = np.floor(at).astype(np.int64)
    low = np.take_along_axis(ordered, below[..., None], -1)[..., 0]
    high = np.take_along_axis(ordered, np.minimum(below + 1, last)[..., None], -1)[..., 0]
    return low + (at - below) * (high - low)


def median(values: Array) -> Array:
    return percentile(values, 50.0)


def p95(values: Array) -> Array:
    return percentile(values, 95.0)


@frozen
class Figures:
    """One method in the seven configurations: figures by name, and their 95 % intervals."""

    values: Mapping[str, float]
    intervals: Mapping[str, Interval]
    flips: int
    refused: int
    given: int
    nees: float

    def summary(self) -> dict[str, Any]:
        plain: dict[str, Any] = {name: plain_number(value) for name, value in self.values.items()}
        plain |= {
            f"{name}_interval": [plain_number(x) for x in ends]
            for name, ends in self.intervals.items()
        }
        plain["flip_rate"] = self.flips / self.given if self.given else None
        plain["flip_rate_interval"] = list(wilson(self.flips, self.given))
        plain["refused_rate"] = self.refused / (self.refused + self.given)
        plain["measurements"] = self.refused + self.given
        plain["nees_mean"] = plain_number(self.nees)
        return plain


def figures_of(results: Results, seed: int) -> Figures:
    """The unit of the intervals is the session: its measurements share print, calibration, mounting
    and biases.
    """
    d2 = results.d2_m[:, SEVEN]
    target = results.target_m[:, SEVEN]
    turned = results.rotation_rad[:, SEVEN]
    wanted: tuple[tuple[Array, dict[str, Statistic]], ...] = (
        (d2, {"d2_mean_m": mean, "d2_median_m": median, "d2_p95_m": p95}),
        (d2[:, SAME], {"d2_same_m": mean}),
        (d2[:, FACING], {"d2_facing_m": mean}),
        (target, {"target_mean_m": mean, "target_median_m": median, "target_p95_m": p95}),
        (np.degrees(turned), {"rotation_mean_deg": mean}),
    )
    values: dict[str, float] = {}
    intervals: dict[str, Interval] = {}
    for errors, statistics in wanted:
        values |= {name: float(statistic(errors.ravel())) for name, statistic in statistics.items()}
        intervals |= _intervals(errors, statistics, np.random.default_rng([seed, 11]))
    refused = int(np.isnan(d2).sum())
    flips = int((turned > FLIPPED_RAD).sum())
    return Figures(
        values,
        intervals,
        flips,
        refused,
        d2.size - refused,
        float(mean(results.nees[:, SEVEN].ravel())),
    )


def _intervals(
    errors: Array, statistics: Mapping[str, Statistic], rng: np.random.Generator
) -> dict[str, Interval]:
    """95 % percentile bootstrap over sessions, all resamples at once: as ``statistics.bootstrap``,
    but faster.
    """
    sessions = len(errors)
    drawn = errors[rng.integers(0, sessions, (RESAMPLES, sessions))].reshape(RESAMPLES, -1)
    ends: dict[str, Interval] = {}
    for name, statistic in statistics.items():
        there = statistic(drawn)
        there = there[~np.isnan(there)]
        low, high = np.percentile(there, (2.5, 97.5)) if there.size else (math.nan, math.nan)
        ends[name] = float(low), float(high)
    return ends


def plain_number(value: float | Array) -> float | None:
    """Return a number for JSON, which knows no NaN."""
    return None if math.isnan(value) else float(value)


def configurations_summary(
    results: Mapping[Method, Results],
    headings: Sequence[float],
    incidence: Sequence[float],
    side_px: Sequence[float],
) -> list[dict[str, Any]]:
    """Geometry of each of the seven and what each method made of it."""
    return [
        {
            "name": c.name,
            "facing": c.facing,
            "range_m": c.range_m,
            "azimuth_deg": c.azimuth_deg,
            "elevation_deg": c.elevation_deg,
            "relative_yaw_deg": math.degrees(headings[k]),
            "target_place": c.place + 1,
            "incidence_deg": math.degrees(incidence[k]),
            "side_px": side_px[k],
            "methods": {
                method: {
                    "d2_mean_m": plain_number(mean(result.d2_m[:, k])),
                    "d2_median_m": plain_number(median(result.d2_m[:, k])),
                    "d2_p95_m": plain_number(p95(result.d2_m[:, k])),
                    "target_mean_m": plain_number(mean(result.target_m[:, k])),
                    "target_p95_m": plain_number(p95(result.target_m[:, k])),
                    "refused_rate": float(np.isnan(result.d2_m[:, k]).mean()),
                }
                for method, result in results.items()
            },
        }
        for k, c in enumerate(CONFIGURATIONS)
    ]


def findings(
    figures: Mapping[str, Mapping[Method, Figures]],
    square_p95_m: float | Array,
    alone: Sequence[tuple[str, Results]],
) -> Sequence[TrialFinding]:
    """The paper's numbers, and the goals, beside ours; ``alone``: the errors of the table one by
    one, with a title.
    """
    own = figures[HEADLINE][DEFAULT]
    raw = figures[HEADLINE]["ippe"]
    parts = sorted(
        ((float(mean(each.target_m[:, SEVEN].ravel())), title) for title, each in alone),
        reverse=True,
    )
    target = "mean error with " + ", ".join(f"{title} {_mm(size)}" for size, title in parts) + " mm"
    worst = (
        f"seen along its normal from 1.5 m, which is none of the seven: p95 {_mm(square_p95_m)} mm"
    )
    out = [
        _finding(own, "d2_mean_m", "D2's position, mean, mm", "47", GOAL_MEAN_M),
        _finding(own, "d2_p95_m", "D2's position, 95th percentile, mm", "", GOAL_P95_M, worst),
        _finding(own, "d2_same_m", "D2's position, same direction, mean, mm", "38"),
        _finding(own, "d2_facing_m", "D2's position, facing D1, mean, mm", "54"),
        _finding(own, "target_mean_m", "target's position, mean, mm", "30", GOAL_MEAN_M, target),
        _finding(own, "target_p95_m", "target's position, 95th percentile, mm", "", GOAL_P95_M, target),
        _finding(raw, "d2_mean_m", "first IPPE solution, D2 mean, mm", "47"),
        _finding(raw, "target_mean_m", "first IPPE solution, target mean, mm", "30"),
    ]  # fmt: skip
    for pipeline in ("ideal", "realistic", "realistic_h264"):
        short = figures[pipeline][DEFAULT]
        title = PIPELINES[pipeline]
        out.append(
            _finding(short, "d2_mean_m", f"D2 mean, camera with {title}, mm", "47", GOAL_MEAN_M)
        )
        out.append(
            _finding(
                short, "target_mean_m", f"target mean, camera with {title}, mm", "30", GOAL_MEAN_M
            )
        )
    return tuple(out)


def _finding(
    figures: Figures,
    name: str,
    quantity: str,
    paper: str,
    goal_m: float | None = None,
    note: str = "",
) -> TrialFinding:
    value, (low, high) = figures.values[name], figures.intervals[name]
    if goal_m is None:
        return TrialFinding(quantity, _mm(value), f"{_mm(low)} to {_mm(high)}", paper, note=note)
    reached = verdict(value <= goal_m)
    return TrialFinding(
        quantity,
        _mm(value),
        f"{_mm(low)} to {_mm(high)}",
        paper,
        f"≤ {1e3 * goal_m:.0f}",
        reached,
        note,
    )


def _mm(metres: float | Array) -> str:
    return "–" if math.isnan(metres) else f"{1e3 * float(metres):.1f}"


def methods_table(title: str, figures: Mapping[Method, Figures]) -> TrialTable:
    def row(method: Method) -> tuple[str, ...]:
        f = figures[method]
        v = f.values
        low, high = f.intervals["d2_mean_m"]
        target_low, target_high = f.intervals["target_mean_m"]
        return (
            METHOD_TITLES[method],
            f"{_mm(v['d2_mean_m'])} ({_mm(low)} to {_mm(high)})", _mm(v["d2_median_m"]), _mm(v["d2_p95_m"]),
            _mm(v["d2_same_m"]), _mm(v["d2_facing_m"]),
            f"{_mm(v['target_mean_m'])} ({_mm(target_low)} to {_mm(target_high)})",
            _mm(v["target_median_m"]), _mm(v["target_p95_m"]), f"{v['rotation_mean_deg']:.2f}",
            f"{f.flips}/{f.given}", f"{f.refused}/{f.given + f.refused}",
        )  # fmt: skip

    columns = ("method", "D2 mean, mm", "median", "p95", "same dir.", "facing", "target mean, mm", "median", "p95",
               "rotation, °", "flips", "refused")  # fmt: skip
    note = "Intervals 95 %, resampled by session. Flips: more than 10° off. Refused: no pose; not in the other figures."
    return TrialTable(title, columns, tuple(row(method) for method in METHODS), note)


def breakdown_table(title: str, rows: Sequence[tuple[str, Results]]) -> TrialTable:
    columns = (
        "errors",
        "D2 mean, mm",
        "p95",
        "target in D2's camera mean, mm",
        "p95",
        "target as sent mean, mm",
    )
    return TrialTable(
        title,
        columns,
        tuple(
            (
                name,
                *(
                    _mm(statistic(errors[:, SEVEN].ravel()))
                    for errors in (result.d2_m, result.target_m)
                    for statistic in (mean, p95)
                ),
                _mm(mean(result.sent_m[:, SEVEN].ravel())),
            )
            for name, result in rows
        ),
        "Default method on the same images. Image and depth noise are always on.",
    )


def configurations_table(summary: Sequence[Mapping[str, Any]]) -> TrialTable:
    rows = tuple(
        (
            c["name"],
            "facing D1" if c["facing"] else "same direction",
            f"{c['range_m']:.2f}",
            f"{c['azimuth_deg']:.0f}",
            f"{c['elevation_deg']:.0f}",
            f"{c['relative_yaw_deg']:.0f}",
            f"{c['incidence_deg']:.0f}",
            f"{c['side_px']:.0f}",
            str(c["target_place"]),
            *(_mm(c["methods"][m]["d2_mean_m"] or math.nan) for m in METHODS),
            *(_mm(c["methods"][m]["target_mean_m"] or math.nan) for m in ("ippe", DEFAULT)),
        )
        for c in summary
    )
    columns = ("", "D2", "range, m", "azimuth, °", "elevation, °", "yaw, °", "incidence, °", "marker, px", "place",
               "D2 mm: IPPE", "gravity SUBPIX", "photometric", "default", "target mm: IPPE", "default")  # fmt: skip
    note = (
        "Azimuth of D2 from behind D1, seen from the marker; "
        "incidence between the marker's normal and the perception."
    )
    return TrialTable("The seven configurations", columns, rows, note)


def noise_table(errors: TrialErrors) -> TrialTable:
    rows = (
        *errors.rows(),
        ("hover", f"{1e3 * HOVER_M:.0f} mm per axis, {math.degrees(HOVER_RAD):.1f}° roll and pitch, "
                  f"{math.degrees(HOVER_YAW_RAD):.0f}° yaw", "frame"),
        ("image", "blur 0.6 px; noise 1.2 grey levels and 0.015 grey levels² per grey level", "pixel"),
        ("depth", f"{1e3 * DEPTH.sigma_at_1m_m:.0f} mm at 1 m, quadratic, correlated over "
                  f"{DEPTH.correlation_px:.0f} px; holes at {100 * DEPTH.hole_rate:.0f} % of the edges", "pixel"),
        ("target", "a car of 0.32 m, turned any way, at three places", "frame"),
        ("told to the estimator", f"side ± {1e3 * SIDE_SIGMA_M:g} mm, focal length ± {100 * SETTINGS.focal_sigma} %, "
                                  f"attitudes ± {math.degrees(SETTINGS.attitude_v_sigma_rad):.1f}°, as in flight", "–"),
        ("camera", f"{CAMERA.width}×{CAMERA.height}, fx {CAMERA.fx:.0f} px, Brown–Conrady {CAMERA.distortion}, both "
                   "drones", "–"),
        ("depth of the target from", f"the middle {100 * METHOD.depth_center_fraction:.0f} % of its box, per side: it "
                                     "is 170 to 300 px wide", "–"),
    )  # fmt: skip
    return TrialTable(
        "Noise: standard deviations, normally distributed",
        ("what", "how much", "drawn anew for every"),
        rows,
    )
