"""The accuracy of corners: error per axis, bias towards or away from the centre, honesty of the
covariance.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from missions.trials.pose.corners.shots import CornerShot
from missions.trials.shared.statistics import RESAMPLES, Interval, whitened, wilson
from path.geometry.transforms import Matrix, Vector
from path.target.kernels import MAD_TO_SIGMA
from path.values import frozen

SCORE_STREAM = 3


@frozen
class Score:
    """The score of one method, over views with one camera in one condition.

    Attributes:
        rms_px, interval_px: per axis; 95 %, views resampled.
        robust_px: 1.48 times the median absolute error per axis.
        radial_px: mean error away from the marker's centre, over the corners.
        found, found_interval: share of the views, 0..1.
        calibration: mean squared error in units of the stated covariance, 1 when that is honest;
            None without one.
        calibration_interval: 95 %, views resampled.
    """

    views: int
    rms_px: float
    interval_px: Interval
    robust_px: float
    radial_px: float
    found: float
    found_interval: Interval
    calibration: float | None = None
    calibration_interval: Interval | None = None

    @property
    def honesty(self) -> str:
        """The calibration as text, "" without one."""
        return calibration_text(self.calibration, self.calibration_interval)

    def summary(self) -> dict[str, Any]:
        named: dict[str, Any] = {
            "rms_px": self.rms_px,
            "rms_interval_px": list(self.interval_px),
            "robust_px": self.robust_px,
            "radial_px": self.radial_px,
            "found": self.found,
            "found_interval": list(self.found_interval),
        }
        if self.calibration is not None:
            named["calibration"] = self.calibration
        return named


def calibration_text(calibration: float | None, interval: Interval | None) -> str:
    """A mean squared error in units of what was stated, and its interval, as text; "" without
    one.
    """
    if calibration is None or interval is None:
        return ""
    return f"{calibration:.2f} ({interval[0]:.2f}–{interval[1]:.2f})"


def score(
    samples: Sequence[CornerShot],
    method: str,
    seed: int,
) -> Score | None:
    """None when the method found nothing."""
    pairs = [
        (sample.true_px, found) for sample in samples if (found := sample.found[method]) is not None
    ]
    if not pairs:
        return None
    rng = np.random.default_rng([seed, SCORE_STREAM])
    errors = np.stack([found.corners_px - true_px for true_px, found in pairs])  # (n, 4, 2)
    squares = np.mean(errors**2, axis=(1, 2))
    covariances = [found.covariance_px2 for _, found in pairs]
    picks = rng.integers(0, len(pairs), (RESAMPLES, len(pairs)))
    calibration = interval = None
    if all(covariance is not None for covariance in covariances):
        honest = np.array(
            [whitened(e, c) for e, c in zip(errors, covariances, strict=True) if c is not None]
        )
        calibration = float(honest.mean())
        interval = _between(honest[picks].mean(axis=1))
    low, high = _between(squares[picks].mean(axis=1))
    return Score(
        len(samples),
        math.sqrt(float(squares.mean())),
        (math.sqrt(low), math.sqrt(high)),
        MAD_TO_SIGMA * float(np.median(np.abs(errors))),
        float(
            np.mean([_radial(e, true_px) for e, (true_px, _) in zip(errors, pairs, strict=True)])
        ),
        len(pairs) / len(samples),
        wilson(len(pairs), len(samples)),
        calibration,
        interval,
    )


def _between(resampled: Vector) -> Interval:
    """95 % of a statistic, from its values over resampled views (all at once: there are hundreds of
    scores).
    """
    low, high = np.percentile(resampled, (2.5, 97.5))
    return float(low), float(high)


def _radial(error_px: Matrix, true_px: Matrix) -> float:
    out = true_px - true_px.mean(axis=0)
    return float(np.mean(np.sum(error_px * out, axis=1) / np.hypot(out[:, 0], out[:, 1])))
