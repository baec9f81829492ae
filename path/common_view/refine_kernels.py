"""Rounds of alignment from one guess, compiled."""

from __future__ import annotations

import numpy as np

from path.arrays import Array
from path.common_view.align_kernels import (
    Known,
    Matches,
    View,
    add_corners,
    add_known,
    add_planes,
)
from path.compiled import kernel
from path.marker.kernels import cholesky, cholesky_solve, exp_times, inverse


@kernel
def refined(
    one: View, two: View, matches: Matches, known: Known, R: Array, t: Array,
    bounds: Array, corner_sigma: float, repeated: float, independent: float, corners: float, covariance: Array,
) -> bool:  # fmt: skip
    """Better a pose in place, a round for each bound; False when nothing holds it.

    Args:
        bounds: (rounds,) of point-to-plane residuals, shares of the distance.
        independent: residuals on planes that may count as independent; ``corners``: corners that may.
        covariance: (6, 6), written: of turn from the left and translation.
    """
    A = np.empty((6, 6))
    b = np.empty(6)
    share = independent / max(1.0, float(len(one.samples) + len(two.samples)))
    share = min(1.0, share)
    for bound in bounds:
        A[:] = 0.0
        b[:] = 0.0
        add_planes(two, one, R, t, 1, bound, share, A, b)
        add_planes(one, two, R, t, -1, bound, share, A, b)
        add_corners(
            matches, R, t, corner_sigma, max(corner_sigma, 0.5 * bound), repeated, corners, A, b
        )
        add_known(known, R, t, A, b)
        for i in range(6):
            for j in range(i):
                A[j, i] = A[i, j]
        covariance[:] = A
        if not cholesky(A):
            return False
        cholesky_solve(A, b)
        turned = exp_times(b[:3], R)
        for i in range(3):
            t[i] += b[3 + i]
            for j in range(3):
                R[i, j] = turned[i, j]
    information = covariance.copy()
    return inverse(information, covariance)
