"""Role clocks that are not the world's: two drones never agree about the time."""

from __future__ import annotations

import asyncio
from typing import Annotated

from drivers.rig.parts import PartContext
from path.bounds import Bounds
from path.values import frozen


@frozen
class OffsetClockConfig:
    """``offset_s`` is added to the loop's time; not negative, as log stamps are unsigned."""

    offset_s: Annotated[float, Bounds(0.0, 1e9)] = 0.0


class OffsetClock:
    """The running loop's time, set apart by a constant."""

    Config = OffsetClockConfig

    def __init__(self, config: OffsetClockConfig, context: PartContext) -> None:
        self._offset_ns = round(config.offset_s * 1e9)

    def now_ns(self) -> int:
        return self._offset_ns + round(asyncio.get_running_loop().time() * 1e9)
