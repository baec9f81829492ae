"""The smallest change that makes something possible: the same check asked again with a fact
changed, halving what lies between what fails and what passes.
"""

from __future__ import annotations

import math
from collections.abc import Callable

_HALVINGS = 24
_FINE = 1.001


def least(fails: float, passes: float, holds: Callable[[float], bool]) -> float | None:
    """Return the least value that holds between one that fails and a larger one; None when that
    fails too.
    """
    if not holds(passes):
        # what is too large may fail for another reason: try on the way up
        value = fails
        while value < passes and not holds(value):
            value *= 1.25
        if value >= passes:
            return None
        passes = value
    for _ in range(_HALVINGS):
        middle = math.sqrt(fails * passes)
        if passes / fails < _FINE:
            break
        if holds(middle):
            passes = middle
        else:
            fails = middle
    return passes


def most(holds_at: float, fails: float, holds: Callable[[float], bool]) -> float:
    """Return the largest value that holds between one that is taken to hold and one that fails."""
    for _ in range(_HALVINGS):
        middle = 0.5 * (holds_at + fails)
        if holds(middle):
            holds_at = middle
        else:
            fails = middle
    return holds_at
