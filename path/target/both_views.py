"""The target's place by both drones' views, once D2's pose is known: triangulation, with all that
either knows.

In D2's camera frame, where D2 is at the origin:

- D1's point ``x1``: along D1's line of sight ``r1`` it is off by D1's range, across it by D1's
  pixels and mount, and all of it by D2's pose, whose turn has the way from the marker to the target
  as its lever, ``C1 = a^2 r1 r1^T + b^2 (I - r1 r1^T) + J P J^T``, with ``J = [I, -[q]x]`` and
  ``q`` from the marker to the target.
- D2's line of sight ``r2`` through the middle of its own box: across it the target is known to a
  pixel or so, whatever pose and mounts are, ``P2 x = 0`` with ``P2 = I - r2 r2^T``, give or take
  ``s`` times the distance.
- D2's own range, where it has one, ``r2^T x = d``.

The estimate is the one of least squares, information added up one after another. ``chi2`` says how
well D2's line of sight agrees with D1's point, two degrees of freedom. Where D1's range is worth
little this is what two bearings make of each other; where they are nearly parallel it leaves the
range as it was, and says so by its covariance.

Both mean the middle of the body, where its size is known: the middles of two boxes from two sides
are two points of it (``path.target.cylinder``).

**What this must not be used for.** D2's box was chosen near D1's point. Whoever feeds a place that
D2's box has pulled towards itself back into D1's message, the prior, the gate or D1's track lets
the gate agree with itself: an object beside the target would draw the point over to it, frame by
frame, and then be found where it is expected. So this is computed after D2's answer is sent, goes
into D2's own track and the log, and nothing of it goes over the link. The rooms of the cycle, the
gate and the protocol may not import this module (``pyproject.toml``).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from path.geometry.transforms import Matrix, Vector
from path.messages import Vec3
from path.values import frozen

Floats = NDArray[np.float64]

CHI2_BEARING = 13.82  # one in a thousand, two degrees of freedom


@frozen
class Sighted:
    """What D1 says, in D2's camera frame.

    Attributes:
        point_c: the target, m; ``from_eye_c``: from D1's camera to it.
        lever_c: from the marker's middle to it.
        along_m, across_m: standard deviations along and across D1's line of sight.
        pose: (6, 6), covariance of ``T_c2_v``, place first; its turn is about the marker.
    """

    point_c: Vector
    from_eye_c: Vector
    lever_c: Vector
    along_m: float
    across_m: float
    pose: Matrix

    @property
    def covariance(self) -> Floats:
        """Return the covariance of the point, shape (3, 3), m2."""
        r1 = self.from_eye_c / max(1e-12, float(np.linalg.norm(self.from_eye_c)))
        along = np.outer(r1, r1)
        x, y, z = self.lever_c.tolist()
        turned = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])
        by_pose = np.hstack((np.eye(3), turned))
        own = self.along_m**2 * along + self.across_m**2 * (np.eye(3) - along)
        return own + by_pose @ self.pose @ by_pose.T


@frozen
class BothViews:
    """The target by both views.

    Attributes:
        point_c: in D2's camera frame, m; ``covariance`` its own, (3, 3), m2.
        chi2: of D2's line of sight against D1's point.
        agree: that is no more than happens to one in a thousand; else the point is D1's alone.
    """

    point_c: Vector
    covariance: Floats
    chi2: float
    agree: bool

    @property
    def sigma_m(self) -> float:
        """Return its standard deviation in its least certain direction."""
        return math.sqrt(float(np.linalg.eigvalsh(self.covariance)[-1]))

    def along(self, ray_c: Vec3) -> tuple[float, float]:
        """Return the depth on a ray that passes it, and the standard deviation of that, m.

        The ray is per metre of depth.
        """
        ray = np.array(ray_c)
        unit = ray / np.linalg.norm(ray)
        per_depth = float(np.linalg.norm(ray))
        distance = float(unit @ self.point_c)
        return distance / per_depth, math.sqrt(float(unit @ self.covariance @ unit)) / per_depth


def triangulate(
    said: Sighted,
    ray_c: Vec3,
    ray_sigma_rad: float,
) -> BothViews:
    """Fuse D1's point with D2's line of sight.

    Args:
        ray_c: of D2's, from its camera, any length.
        ray_sigma_rad: standard deviation of its direction, per axis: pixels and lens.
    """
    x1 = said.point_c
    C1 = said.covariance
    across = _across(np.array(ray_c))
    noise_m = ray_sigma_rad * float(np.linalg.norm(x1))
    off = across @ x1
    S = across @ C1 @ across.T + noise_m**2 * np.eye(2)
    chi2 = float(off @ np.linalg.solve(S, off))
    if not chi2 <= CHI2_BEARING:
        return BothViews(x1, C1, chi2, agree=False)
    gain = np.linalg.solve(S, across @ C1).T
    kept = np.eye(3) - gain @ across
    # Joseph's form: stays symmetric and positive, however good one of the two is
    covariance = kept @ C1 @ kept.T + noise_m**2 * gain @ gain.T
    return BothViews(x1 - gain @ off, covariance, chi2, agree=True)


def with_range(
    both: BothViews,
    ray_c: Vec3,
    distance_m: float,
    sigma_m: float,
) -> BothViews:
    """Add D2's own range along its line of sight, unless it contradicts."""
    unit = np.array(ray_c) / np.linalg.norm(ray_c)
    off_m = distance_m - float(unit @ both.point_c)
    seen = both.covariance @ unit
    variance = float(unit @ seen) + sigma_m**2
    if off_m**2 > CHI2_BEARING * variance:
        return both
    gain = seen / variance
    kept = np.eye(3) - np.outer(gain, unit)
    covariance = kept @ both.covariance @ kept.T + sigma_m**2 * np.outer(gain, gain)
    return BothViews(both.point_c + gain * off_m, covariance, both.chi2, both.agree)


def _across(ray: Floats) -> Floats:
    """Return two unit vectors across a ray, as rows, shape (2, 3)."""
    unit: Floats = ray / np.linalg.norm(ray)
    other: Floats = np.eye(3)[int(np.argmin(np.abs(unit)))]
    first: Floats = np.cross(unit, other).real
    first = first / np.linalg.norm(first)
    second: Floats = np.cross(unit, first).real
    return np.stack((first, second))
