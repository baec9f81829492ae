"""How the kernels are compiled: cached on disk, without the GIL, exact IEEE arithmetic (the same on every CPU)."""

from __future__ import annotations

from numba import njit

kernel = njit(cache=True, nogil=True, error_model="numpy")  # division by zero gives inf, which lets loops vectorise
