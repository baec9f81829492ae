"""Rigid transforms and small rotation helpers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from path.values import value

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


@value
class Pose:
    """A rigid transform ``T_a_b``: maps coordinates in frame ``b`` to frame ``a``, ``p_a = R p_b +
    t``.

    Attributes:
        R: rotation matrix, shape (3, 3).
        t: translation in metres, shape (3,): the origin of ``b`` expressed in ``a``.
    """

    R: Matrix
    t: Vector

    def __matmul__(self, other: Pose) -> Pose:
        """Chain transforms: ``T_a_c = T_a_b @ T_b_c``."""
        return Pose(self.R @ other.R, self.R @ other.t + self.t)

    def inverse(self) -> Pose:
        """``T_b_a`` from ``T_a_b``."""
        return Pose(self.R.T, -self.R.T @ self.t)

    def apply(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Map points of shape (3,) or (n, 3) from ``b`` to ``a``."""
        return points @ self.R.T + self.t
