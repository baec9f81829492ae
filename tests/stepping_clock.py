"""A drone's clock that somebody sets while it flies: a time daemon, or a person."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import Annotated

from drivers.rig.parts import PartContext
from path.bounds import Bounds


@dataclass(frozen=True, slots=True)
class SteppingClockConfig:
    """
    Attributes:
        offset_s: added to the loop's time.
        step_s: by which it is set.
        at_s: when, loop's time.
    """

    offset_s: Annotated[float, Bounds(0.0, 1e9)] = 100.0
    step_s: Annotated[float, Bounds(-100.0, 100.0)] = 5.0
    at_s: Annotated[float, Bounds(0.0, 1e6)] = 30.0


class SteppingClock:
    """The running loop's time, set once."""

    Config = SteppingClockConfig

    def __init__(self, config: SteppingClockConfig, context: PartContext) -> None:
        self._config = config

    def now_ns(self) -> int:
        now_s = asyncio.get_running_loop().time()
        stepped_s = self._config.step_s if now_s >= self._config.at_s else 0.0
        return round((now_s + self._config.offset_s + stepped_s) * 1e9)
