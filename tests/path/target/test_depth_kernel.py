"""The compiled middle of a surface's depths is numpy's, to the bit."""

from __future__ import annotations

import numpy as np
import pytest

from path.target.kernels import MAD_TO_SIGMA, OUTLIER_SIGMAS, middle

LEAST_MM, MOST_MM, SIGMA_M = 300.0, 6000.0, 0.005


@pytest.mark.parametrize("sigma_mm", [2.0, 40.0, 900.0])
def test_the_middle_is_numpys(sigma_mm: float) -> None:
    rng = np.random.default_rng(int(sigma_mm))
    for count in (1, 2, 3, 4, 17, 100, 1001):
        depths_mm = np.clip(rng.normal(2000.0, sigma_mm, count), 0.0, 65_535.0).astype(np.uint16)
        depths_mm[rng.random(count) < 0.2] = 0
        valid = depths_mm[(depths_mm >= LEAST_MM) & (depths_mm <= MOST_MM)].astype(float)
        found = middle(depths_mm, LEAST_MM, MOST_MM, SIGMA_M, np.empty(count))
        assert found[0] == valid.size
        if valid.size:
            about = float(np.median(valid))
            off = np.abs(valid - about)
            spread = max(
                MAD_TO_SIGMA * float(np.median(off)), 1000.0 * (SIGMA_M * (about / 1000.0) ** 2)
            )
            assert found[1] == pytest.approx(spread, rel=1e-15)
            assert found[2] == np.median(valid[off <= OUTLIER_SIGMAS * spread])
