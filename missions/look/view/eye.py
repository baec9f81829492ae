"""The place that the scene is looked at from at first: where both drones fly, and not the whole of
their fence.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from path.messages import Vec3
from path.values import frozen

BESIDE_M = 1.0  # around the drones' paths, for what they look at
SHARE = 70.0  # percent of the places that have to be seen well
FROM = (-0.55, -0.7, 0.45)  # of the direction to the eye, in the world's frame (east, north, up)
AWAY = 1.4  # of what is seen, whose half is so far from its middle: Rerun's eye opens 55 degrees


@frozen
class SceneEye:
    """``position`` and the point that is looked at, in the world's frame, m."""

    position: Vec3
    target: Vec3


def eye_of(paths: Iterable[Iterable[Vec3]]) -> SceneEye | None:
    """The eye for the drones' paths, in the world's frame; None while there are none."""
    places = np.array([place for path in paths for place in path], float).reshape(-1, 3)
    if not len(places):
        return None
    middle = np.median(places, axis=0)
    half_m = float(np.percentile(np.linalg.norm(places - middle, axis=1), SHARE)) + BESIDE_M
    away = AWAY * half_m / math.hypot(*FROM)
    x, y, z = middle.tolist()
    east, north, up = (middle + away * np.array(FROM)).tolist()
    return SceneEye((east, north, up), (x, y, z))
