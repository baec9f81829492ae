"""The camera of level ``sim-rendered``: frames drawn by the renderer, in virtual time.

The truth is looked at when the picture is taken. A picture that somebody waits for, of a camera
whose last frame was looked at, is drawn in a thread while other events happen, and only who looks
at it waits for it: so two cameras draw on two cores. Any other picture is drawn when it is looked
at, and most of those never are. What is drawn depends on nothing but the seed.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import field
from functools import partial
from threading import Lock
from typing import Annotated, Self

import numpy as np

from drivers.interfaces import CameraError, Frame
from drivers.rig.parts import PartContext
from flight.harness.renderer import Imaging
from hil.camera.capture import CaptureTicker, CaptureTiming, timing_of, true_camera
from hil.camera.pending import DrawnFrame, Images, PendingPicture
from hil.camera.pipeline import develop
from hil.render.mosaic import is_quick
from hil.render.renderer import Renderer
from hil.render.sensor import SensorNoise
from hil.render.shutter import shutter_of
from hil.world.seam import harness_of
from hil.world.snapshot import Snapshot
from path.arrays import Image
from path.bounds import Bounds
from path.camera.model import CameraModel
from path.values import frozen


@frozen
class RenderedCameraConfig:
    """The timing of frames (see ``hil.camera.capture.timing_of``), and the noise of the sensor.

    Attributes:
        imaging: of another camera (docs/real.md) than the world's (``[world.imaging]``).
    """

    rate_hz: Annotated[float, Bounds(1.0, 300.0)] = 30.0
    phase_s: Annotated[float | None, Bounds(0.0, 10.0)] = None
    latency_s: Annotated[float, Bounds(0.0, 2.0)] = 0.02
    noise: SensorNoise = field(default_factory=SensorNoise)
    imaging: Imaging | None = None

    def timing(self, context: PartContext) -> CaptureTiming:
        return timing_of(context.role, self.rate_hz, self.phase_s, self.latency_s)

    def __post_init__(self) -> None:
        CaptureTiming(self.rate_hz, self.phase_s or 0.0, self.latency_s)


class RenderedCamera:
    """Implements ``drivers.interfaces.Camera`` for a rig whose harness is a ``PartHarness``."""

    Config = RenderedCameraConfig

    def __init__(self, config: RenderedCameraConfig, context: PartContext) -> None:
        harness = harness_of(context.harness, "a rendered camera", CameraError)
        self._model = context.camera
        self._role = context.role
        true = true_camera(context, harness.built)
        imaging = config.imaging or true.imaging
        quick = imaging if imaging is not None and is_quick(imaging) else None
        self._renderer = Renderer(
            true.camera,
            true.T_b_c,
            true.T_b_v,
            true.layout,
            config.noise,
            harness.seed,
            true.scene,
            quick,
            shutter_of(true.errors),
            true.errors.depth_error,
        )
        self._imaging = None if quick is not None else imaging
        name = f"the {context.role.value}'s rendered camera"
        self._ticker: CaptureTicker[PendingPicture] = CaptureTicker(
            name,
            config.timing(context),
            context.role,
            context.clock,
            harness,
            self._take,
        )
        self._thread: ThreadPoolExecutor | None = None
        self._lock = Lock()
        self._last: PendingPicture | None = None

    @property
    def model(self) -> CameraModel:
        return self._model

    @property
    def skipped(self) -> int:
        """Frames that were replaced by a newer one before they were read."""
        return self._ticker.skipped

    async def __aenter__(self) -> Self:
        # One thread: the renderer keeps scratch buffers, and frames of one camera come one after
        # the other anyway.
        self._thread = ThreadPoolExecutor(1, thread_name_prefix=f"draw-{self._role.value}")
        return self

    async def __aexit__(self, *_: object) -> None:
        self._ticker.close()
        if self._thread is not None:
            self._thread.shutdown(wait=True, cancel_futures=True)
            self._thread = None

    async def read(self, timeout_s: float) -> Frame:
        """The newest frame not yet given. Raises CameraError when none was taken in time."""
        if self._thread is None:
            raise CameraError("the rendered camera is not open", "open it with `async with`")
        capture = await self._ticker.next(timeout_s)
        self._last = capture.content
        return DrawnFrame(
            capture.stamp_ns,
            capture.frame_id,
            capture.content,
            (self._model.width, self._model.height),
        )

    def _take(self, snapshot: Snapshot, frame_id: int) -> PendingPicture:
        assert self._thread is not None, "nothing is captured before somebody reads"
        picture = PendingPicture(partial(self._draw, snapshot, frame_id), self._lock)
        if self._ticker.awaited and (self._last is None or self._last.looked):
            picture.begin(self._thread)
        return picture

    def _draw(self, snapshot: Snapshot, frame_id: int) -> Images:
        exposed = None if self._imaging is None else partial(_developed, self._imaging)
        return self._renderer.render(snapshot, self._role, frame_id, exposed)


def _developed(
    imaging: Imaging,
    light: Image,
    key: int,
) -> Image:
    return develop(light, imaging, np.random.default_rng(key))
