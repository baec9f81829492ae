"""Pixels that a camera leaves out are told by many edges, and by none of few."""

from __future__ import annotations

import numpy as np

from path.calibration.edges import see_edge
from path.calibration.thinned import measure_thinning


def test_a_single_short_edge_tells_nothing() -> None:
    """Each bin of the mean edge has too few pixels: a small board far away."""
    v, u = np.mgrid[:60, :60]
    grey = np.where(u > 24.0 + 0.2 * v, 220, 30).astype(np.uint8)
    edge = see_edge(grey, np.array([[26.0, 10.0], [34.0, 50.0]]))
    assert edge is not None
    assert measure_thinning([edge]) is None
