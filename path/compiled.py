"""The decorator of compiled kernels: kept on disk, without the GIL, in exact IEEE arithmetic, the
same on every CPU.

Without fast-math, so that results do not depend on the machine; division by zero gives inf or NaN,
as in C, which is less to compile than an exception at each division, and lets loops vectorise.

A kernel's cache is renewed when its own file changes, not when a constant or a kernel it takes from
another file does: after such a change clear the ``__pycache__`` beside it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit
from numba.core.caching import FunctionCache
from numba.core.runtime.nrt import rtsys
from numba.extending import register_jitable

_COMPILED: Any = njit  # its stubs do not know all of its options
_CACHE: Any = FunctionCache


class KernelCache(_CACHE):
    """Numba's cache on disk, without what only compiling needs.

    Numba fills its compiler's tables before it looks for a kernel on disk, which takes longer than
    to load all kernels of a flight. What is not on disk is compiled as usual: compiling fills the
    tables itself.
    """

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The kernel as it was kept for these types of arguments; None when it was not, or from
        another source.
        """
        rtsys.initialize(target_context)  # what kernels make their arrays with
        return self._load_overload(sig, target_context)


def _kept(**options: bool) -> Callable[[Any], Any]:
    compiled = _COMPILED(nogil=True, error_model="numpy", no_cfunc_wrapper=True, **options)

    def decorated(function: Any) -> Any:
        dispatcher = compiled(function)
        dispatcher._cache = KernelCache(function)  # as numba does itself for `cache=True`
        return dispatcher

    return decorated


kernel: Any = _kept()
"""For what Python calls."""

inner: Any = _kept(no_cpython_wrapper=True)
"""For what only other kernels call: without the part that unpacks Python's objects, which takes as
long to compile as a small kernel. Python that calls one of these crashes;
``tests/path/test_compiled.py`` looks for such calls."""

as_it_is: Any = register_jitable(nogil=True, error_model="numpy", no_cpython_wrapper=True)
"""For what kernels call compiled, and Python as it is: the same lines for both."""
