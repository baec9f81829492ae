"""One object that a detector shows as two boxes, for a frame.

Two boxes that together are as large as the object was, and more nearly so than the first alone, are
the object: two that look alike take more room than one.
"""

from __future__ import annotations

from path.observations import Box, around

# by so much of its side two pieces together may differ from the object when it was last whole
_PIECES = 0.1


def whole_of(
    first: Box,
    other: Box,
    side_px: tuple[float, float],
) -> Box | None:
    """The box around two that are the object with those sides; None where they are not."""
    both = around((first, other))
    off = _odds(both, side_px)
    return both if off < _PIECES and off < _odds(first, side_px) else None


def _odds(box: Box, side_px: tuple[float, float]) -> float:
    """Return by what share a box's sides differ from what is expected; the worse of the two."""
    return max(abs(box.w / side_px[0] - 1.0), abs(box.h / side_px[1] - 1.0))
