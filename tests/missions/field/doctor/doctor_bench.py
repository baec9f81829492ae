"""A D415 in software that films one picture, as the source of a rig's camera."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.realsense.sdk_import import import_realsense
from drivers.rig.parts import PartContext
from tests.drivers.realsense.software_d415 import DEPTH, DEPTH_MM, Feed

BENCHES: dict[str, Bench] = {}


@dataclass(frozen=True, slots=True)
class NamedConfig:
    name: str


class Named:
    """A source that a rig can name: gives the bench of that name."""

    Config = NamedConfig

    def __new__(cls, config: NamedConfig, context: PartContext) -> Any:
        return BENCHES[config.name]


class Bench(Feed):
    """``skip``: of so many frames one never comes. ``device``: what the device says of itself."""

    def __init__(
        self, picture: NDArray[np.uint8], skip: int = 0, device: dict[str, str] | None = None
    ) -> None:
        super().__init__()
        self.picture, self.skip, self.device = picture, skip, device or {}

    def open(self) -> Any:
        device = super().open()
        for name, value in self.device.items():
            device.register_info(getattr(import_realsense().camera_info, name), value)
        return device

    def give(self, stamp_ns: int | None = None, *, color: bool = True, depth: bool = True) -> int:
        self.number += 1
        software, stamp_ns = self.software, stamp_ns or time.monotonic_ns()
        if software is None or not self.plugged or (self.skip and self.number % self.skip == 0):
            return stamp_ns
        wall = np.full((DEPTH.height, DEPTH.width), DEPTH_MM, np.uint16)
        if depth:
            software.give("depth", software.image("depth", wall, stamp_ns, self.number), stamp_ns)
        if color:
            software.give(
                "color", software.image("color", self.picture, stamp_ns, self.number), stamp_ns
            )
        return stamp_ns
