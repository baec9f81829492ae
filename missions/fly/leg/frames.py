"""The frames that a role takes up: which ones, what of them is logged, and what gives way on a busy
computer.
"""

from __future__ import annotations

import asyncio

from drivers.interfaces import Clock, Framed, FrameLog, Log, Perception, View
from flight.config import MissionConfig
from flight.shedding import Shedding


class Frames:
    """The frames of one role's camera.

    Attributes:
        shedding: what is given up while the program is busy all the time.
    """

    def __init__(
        self,
        perception: Perception,
        clock: Clock,
        config: MissionConfig,
        log: Log,
    ) -> None:
        self._perception = perception
        self._clock = clock
        self._config = config
        self._log = log
        self.shedding = Shedding()
        self._recording = log if config.record == "all" and isinstance(log, FrameLog) else None
        self._image_ns = -(1 << 62)

    @property
    def recorded(self) -> bool:
        """Return whether every frame is recorded, so that perception can be run again."""
        return self._recording is not None

    async def view(self, timeout_s: float) -> View:
        """The newest view not yet given, recorded if the rig says so. Raises CameraError when none
        came in time.

        On a computer that does not keep up frames are left out before it.
        """
        wait_s = self.shedding.until_next_s(self._clock.now_ns())
        if wait_s > 0.0:
            await asyncio.sleep(wait_s)
        view = await self._perception.view(timeout_s)
        self.shedding.took(view.frame_id, view.stamp_ns, self._clock.now_ns())
        if self._recording is not None and isinstance(view, Framed):
            self._recording.frame(view.frame)
        return view

    def log_image(self, view: View, wanted: bool = False) -> None:
        """Log the camera's image, ``image_hz`` times a second at the most, unless this one is
        ``wanted``.

        At 0 those alone are logged, and none when the rig records none.
        """
        config = self._config
        if config.record == "none":
            return
        period_ns = round(1e9 / config.image_hz) if config.image_hz > 0.0 else 1 << 63
        if view.stamp_ns - self._image_ns < (1 if wanted else period_ns) or not (
            wanted or self.shedding.pictures
        ):
            return
        image = view.image()
        if image is not None:
            self._image_ns = view.stamp_ns
            self._log.image("/image", view.stamp_ns, image)
