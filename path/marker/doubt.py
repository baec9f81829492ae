"""The error of a camera's calibration in a marker's pose: focal lengths, centre and distortion, off
together.
"""

from __future__ import annotations

import math

import numpy as np

from path.compiled import kernel
from path.marker.kernels import Array, distort, inverse
from path.marker.pose_kernels import linearize, normal


@kernel
def widen(
    R: Array, t: Array, points: Array, pixels: Array, whitening: Array, lens: Array, down: Array, weight: float,
    doubts: Array, out: Array,
) -> float:  # fmt: skip
    """Add to the covariance ``out`` (6, 6) of a pose what the camera's calibration does not know.

    Args:
        R, t: the pose at which the fit ended; the others as in ``pose_kernels.linearize``.
        doubts: (k, 9) of fx, fy, cx, cy, k1, k2, p1, p2, k3: by how much they are off together, one
            standard deviation of each of k independent causes.

    Returns:
        The standard deviation of the position, mean over the axes; NaN when the pose is not
        determined.
    """
    rows = 8 * whitening.shape[0] + 3
    left = np.zeros(rows)
    jacobian = np.zeros((rows, 6))
    information = np.zeros((6, 6))
    gradient = np.zeros(6)
    spread = np.zeros((6, 6))
    linearize(R, t, points, pixels, whitening, lens, down, weight, left, jacobian)
    normal(jacobian, left, information, gradient)
    if not inverse(information, spread):
        return math.nan
    moved_px = np.empty(8)
    pull = np.empty(6)
    moved = np.empty(6)
    for cause in range(doubts.shape[0]):
        d = doubts[cause]
        pull[:] = 0.0
        for m in range(whitening.shape[0]):
            for c in range(4):
                p = points[4 * m + c]
                z = R[2, 0] * p[0] + R[2, 1] * p[1] + R[2, 2] * p[2] + t[2]
                x = (R[0, 0] * p[0] + R[0, 1] * p[1] + R[0, 2] * p[2] + t[0]) / z
                y = (R[1, 0] * p[0] + R[1, 1] * p[1] + R[1, 2] * p[2] + t[1]) / z
                u, v, _, _, _, _ = distort(x, y, lens)
                r2 = x * x + y * y
                radial = r2 * (d[4] + r2 * (d[5] + r2 * d[8]))
                dx = x * radial + 2.0 * d[6] * x * y + d[7] * (r2 + 2.0 * x * x)
                dy = y * radial + d[6] * (r2 + 2.0 * y * y) + 2.0 * d[7] * x * y
                moved_px[2 * c] = d[0] * (u - lens[2]) / lens[0] + d[2] + lens[0] * dx
                moved_px[2 * c + 1] = d[1] * (v - lens[3]) / lens[1] + d[3] + lens[1] * dy
            for r in range(8):
                white = 0.0
                for s in range(r + 1):
                    white += whitening[m, r, s] * moved_px[s]
                for k in range(6):
                    pull[k] += jacobian[8 * m + r, k] * white
        for i in range(6):
            moved[i] = 0.0
            for j in range(6):
                moved[i] += spread[i, j] * pull[j]
        for i in range(6):
            for j in range(6):
                out[i, j] += moved[i] * moved[j]
    return math.sqrt((out[0, 0] + out[1, 1] + out[2, 2]) / 3.0)
