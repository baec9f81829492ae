"""Time by stage: how long a core was kept busy."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import ParamSpec, TypeVar

from drivers.clock import busy_ns
from drivers.perception.pixels import PixelView
from path.arrays import Image
from path.geometry.transforms import Pose
from path.observations import Box, Depth, Detection, MarkerDetection, Region

P = ParamSpec("P")
R = TypeVar("R")


class Stopwatch:
    """Time that each stage of one cycle kept the core busy, us; what asking for the time takes is
    taken off.
    """

    def __init__(self, overhead_ns: int) -> None:
        self.us: dict[str, float] = {}
        self._overhead_ns = overhead_ns

    def __call__(
        self, stage: str, call: Callable[P, R], *arguments: P.args, **options: P.kwargs
    ) -> R:
        """Return the call's value, timed as a stage."""
        begin_ns = busy_ns()
        result = call(*arguments, **options)
        self.us[stage] = max(0, busy_ns() - begin_ns - self._overhead_ns) / 1e3
        return result


def overhead_ns() -> int:
    """Return the time that asking for the time twice takes."""
    return sorted(-busy_ns() + busy_ns() for _ in range(1001))[500]


class TimedView:
    """A view of D2 that times how long its markers take to find (``drivers.interfaces.View``)."""

    def __init__(self, view: PixelView, watch: Stopwatch) -> None:
        self._view = view
        self._watch = watch
        self.region: Region | None = None
        self.expected: Pose | None = None

    @property
    def stamp_ns(self) -> int:
        return self._view.stamp_ns

    @property
    def frame_id(self) -> int:
        return self._view.frame_id

    def targets(self, region: Region | None) -> Sequence[Detection]:
        return self._view.targets(region)

    def markers(
        self, region: Region | None, expected: Pose | None = None
    ) -> Sequence[MarkerDetection]:
        self.region = region
        self.expected = expected
        return self._watch("d2_marker_corners", self._view.markers, region, expected)

    def depth(self, box: Box) -> Depth | None:
        return self._view.depth(box)

    def image(self) -> Image:
        return self._view.image()
