"""The decorator of compiled kernels: kept on disk, without the GIL, in exact IEEE arithmetic, the same on every CPU.

Without fast-math, so that results do not depend on the machine; division by zero gives inf or NaN, as in C, which is
less to compile than an exception at each division, and lets loops vectorise.

A kernel's cache is renewed when its own file changes, not when a constant or a kernel it takes from another file does:
after such a change clear the ``__pycache__`` beside it.
"""

from __future__ import annotations

from typing import Any

from numba import njit

_COMPILED: Any = njit  # its stubs do not know all of its options

kernel = _COMPILED(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
"""For what Python calls."""

inner = _COMPILED(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True, no_cpython_wrapper=True)
"""For what only other kernels call: without the part that unpacks Python's objects, which takes as long to compile as a
small kernel. Python that calls one of these crashes; ``tests/path/test_compiled.py`` looks for such calls."""
