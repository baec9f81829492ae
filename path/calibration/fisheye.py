"""Whether views of a board are of a fisheye: an equidistant lens fits their corners, and
Brown-Conrady's does not.

A fisheye's corners leave residuals that look like a weak set's, and its focal length comes out
wrong by several of its own standard errors. So the other lens is fitted to the same corners, and
what it leaves is held against that.
"""

from __future__ import annotations

import cv2
import numpy as np

from path.calibration.board import Board
from path.calibration.intrinsics import Intrinsics, rms
from path.values import frozen

# of Brown-Conrady's residual: what three radial terms describe as well is no fisheye for us
CLEARLY = 0.95
NO_CHANCE = 30.0  # by which chi-square falls, beyond what chance gives a lens of no more numbers
# times: fewer radial terms than three leave so much more that they do not describe the lens
LEFT = 1.05
FEWEST = 6  # corners of a view for a fisheye's pose


@frozen
class FisheyeFit:
    """What an equidistant lens leaves of the same corners, px, and its focal length. ``corners``:
    how many.
    """

    rms_px: float
    brown_conrady_px: float
    focal_px: float
    corners: int

    @property
    def is_clear(self) -> bool:
        """Whether it describes the views and Brown-Conrady does not."""
        ratio = self.rms_px / self.brown_conrady_px
        return ratio < CLEARLY and 2 * self.corners * (1.0 / ratio**2 - 1.0) > NO_CHANCE

    def instead_of(self, taken_px: float) -> bool:
        """Whether it describes the views as well as three radial terms, and the fewer ones that
        were taken do not.
        """
        return self.rms_px <= self.brown_conrady_px and taken_px > LEFT * self.brown_conrady_px


def fit_fisheye(solution: Intrinsics, board: Board) -> FisheyeFit | None:
    """Fit an equidistant lens to the views of a solution; None where there is no such fit."""
    views = [view for view in solution.views if len(view.ids) >= FEWEST]
    objects = [board.corners_o[view.ids].reshape(1, -1, 3) for view in views]
    corners = [np.asarray(view.corners_px, np.float64).reshape(1, -1, 2) for view in views]
    width, height = solution.size
    focal = solution.values[0]
    K = np.array(
        [[focal, 0.0, 0.5 * (width - 1)], [0.0, focal, 0.5 * (height - 1)], [0.0, 0.0, 1.0]]
    )
    flags = _flag("USE_INTRINSIC_GUESS") | _flag("RECOMPUTE_EXTRINSIC") | _flag("FIX_SKEW")
    try:
        _, matrix, lens, turns, places = cv2.fisheye.calibrate(
            objects,
            corners,
            (width, height),
            K,
            np.zeros((4, 1)),
            flags=flags,
        )
        errors = [
            cv2.fisheye.projectPoints(points, turn, place, matrix, lens)[0].reshape(-1, 2)
            - seen.reshape(-1, 2)
            for points, seen, turn, place in zip(objects, corners, turns, places, strict=True)
        ]
    except cv2.error:
        return None
    left = rms(np.concatenate(errors))
    if not np.isfinite(left):
        return None
    own = rms(np.concatenate([view.errors_px for view in views]))
    return FisheyeFit(left, own, float(matrix[0, 0]), sum(len(view.ids) for view in views))


def _flag(name: str) -> int:
    """OpenCV 4 keeps these with its fisheye, and with other values elsewhere; OpenCV 5 has one of
    each.
    """
    return int(getattr(cv2.fisheye, f"CALIB_{name}", getattr(cv2, f"CALIB_{name}", 0)))
