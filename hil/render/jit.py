"""The compilation of kernels: cached on disk, without the GIL, exact IEEE arithmetic (the same on every CPU).

A kernel's cache is renewed when its own file changes, not when a constant or a kernel it takes from another file does:
after such a change clear ``hil/render/__pycache__``.
"""

from __future__ import annotations

from numba import njit

kernel = njit(cache=True, nogil=True, error_model="numpy")  # division by zero gives inf, which lets loops vectorise
