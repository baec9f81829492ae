"""Compile, or load from numba's cache, what the belief computes, before a flight needs it."""

from __future__ import annotations

import numpy as np

from path.belief.boxes import Measured
from path.belief.motion import along_ray
from path.belief.objects import Belief

FRAME_NS = 20_000_000
AHEAD = np.array([0.0, 0.0, 1.0])


def warm_up_belief() -> None:
    """Follow one object through two frames. Raises RuntimeError when it is not the designated one
    any more.
    """
    place_m = 2.0 * AHEAD
    noise_m2 = along_ray(AHEAD, 1e-4, 1e-4)
    box = Measured(
        place_m, noise_m2, np.zeros(3), np.eye(3), (0.3, 0.3), 0.03, (0.4, 0.4), 1e-3, 5e-3
    )
    belief = Belief(0.6)
    belief.designate(place_m, box, 0)
    for frame in (1, 2):
        belief.update([box], lambda _: True, frame * FRAME_NS)
    if not belief.identity_of(0) > 0.9:
        raise RuntimeError("an object that is alone is not followed: reinstall numba")
