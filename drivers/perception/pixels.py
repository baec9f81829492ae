"""The perception of a role with a camera: its frames, and what a detector and the marker finder see
in them.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Sequence
from dataclasses import field, replace
from types import TracebackType
from typing import Annotated, Literal, Self

from drivers.interfaces import Camera, CameraError, Capability, Detector, Frame, lacking
from drivers.perception.depth_mask import without_elsewhere
from drivers.perception.depth_pieces import DepthSlice
from drivers.perception.freshness import Freshness
from drivers.rig.calibration_file import check_serial, check_size
from drivers.rig.part_check import Finding, examined, rate_of
from drivers.rig.parts import PartContext, PartSpec, create
from drivers.rig.tables import RigError
from path.arrays import Image
from path.bounds import Bounds
from path.camera.model import CameraModel
from path.config import MethodConfig
from path.gate.agreement import iou
from path.geometry.transforms import Pose
from path.marker.detect import detect_markers
from path.marker.layout import MarkerLayout
from path.marker.photometric.known import Memory
from path.observations import Box, Depth, Detection, MarkerDetection, Region
from path.target.monocular import TargetSize, extent_at, monocular_range
from path.target.place import depth_sigma, registered_depth
from path.values import frozen

Corners = Literal["photometric", "subpix"]
DEPTH_SIGMAS = 2.0  # of the depth camera's own noise
# of the event loop before a frame that waits already: a setpoint takes as many from its timer to
# the wire
_TURNS = 3
RANGE_SIGMAS = 3.0  # of a range by the target's size
# of a box with the same before depth cut something off; of a piece that looks whole
UNCUT_IOU = 0.85
CUT_SCORE = 0.5


@frozen
class PixelPerceptionConfig:
    """
    Attributes:
        camera, detector: parts by name.
        corners: how marker corners are refined.
        method: of the method's settings, those about depth.
        target: size of the target, for a camera without depth: how far away it is, is taken from
            its box.
        max_old_frames: this many frames in a row with an old or repeated stamp are a fault of the
            camera's clock.
    """

    camera: PartSpec
    detector: PartSpec
    corners: Corners = "photometric"
    method: MethodConfig = field(default_factory=MethodConfig)
    target: TargetSize | None = None
    max_old_frames: Annotated[int, Bounds(1, 10000, "frames")] = 30


class PixelPerception:
    """Implements ``drivers.interfaces.Perception`` over a camera, which it opens, and a
    detector.
    """

    Config = PixelPerceptionConfig

    def __init__(self, config: PixelPerceptionConfig, context: PartContext) -> None:
        self._config = config
        self._camera: Camera = create(config.camera, context)
        self._detector: Detector = create(config.detector, context)
        if not callable(getattr(self._detector, "detect", None)):
            named = f"{config.detector.where}.factory: {config.detector.factory}"
            raise RigError(
                [f"{named} is no detector: it has no detect(image, region) -> list of Detection"]
            )
        self._layout = context.layout
        self._calibrated_serial = context.camera_serial
        self._freshness = Freshness(config.max_old_frames)
        self._memory: Memory = {}

    @property
    def dropped(self) -> int:
        """Frames that came with an old or repeated stamp or id and were not given on."""
        return self._freshness.dropped

    @property
    def model(self) -> CameraModel:
        return self._camera.model

    @property
    def lacks(self) -> frozenset[Capability]:
        """The abilities that the camera lacks, but for ranges that the target's size gives."""
        of_camera = lacking(self._camera)
        return of_camera if self._config.target is None else of_camera - {Capability.RANGE}

    @property
    def rate_hz(self) -> float | None:
        """Frames a second that the camera is set to; None when it does not say."""
        return rate_of(self._camera)

    async def examine(self) -> Sequence[Finding]:
        """Return the camera's own findings, and whether it is the calibrated one."""
        return [*await examined(self._camera), self._serial()]

    def _serial(self) -> Finding:
        """Another camera than the calibrated one is refused when it is opened."""
        serial: str = getattr(self._camera, "serial", "")
        if self._calibrated_serial and serial:
            return Finding("ok", "calibration", f"is of this camera, serial {serial}")
        silent = f"this camera is {serial}" if serial else "it is not compared with the camera's"
        of = (
            f"is of serial {self._calibrated_serial}"
            if self._calibrated_serial
            else "does not say of which camera it is"
        )
        fix = (
            "calibrate it: `path-handoff calibrate camera` writes the serial number down"
            if serial
            else ""
        )
        return Finding("note", "calibration", f"{of}; {silent}", fix)

    async def __aenter__(self) -> Self:
        """Open the camera. Raises CameraError, also when it is not the one that the calibration is
        of.
        """
        camera = await self._camera.__aenter__()
        try:
            check_serial(self._calibrated_serial, getattr(camera, "serial", ""), "camera")
        except CameraError:
            await self._camera.__aexit__(None, None, None)
            raise
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        await self._camera.__aexit__(kind, error, trace)

    async def view(self, timeout_s: float) -> PixelView:
        """The newest view not yet given.

        Raises:
            CameraError: none came in time, its size is not that of the calibration, or the camera's
                clock went back.
        """
        for _ in range(_TURNS):
            await asyncio.sleep(0)
        return self.view_of(await self._freshness.next(self._camera.read, timeout_s))

    def view_of(self, frame: Frame) -> PixelView:
        """The view of a frame, whoever has it; the camera need not be open. Raises CameraError for
        another size.
        """
        _check_size(frame, self.model)
        config = self._config
        return PixelView(
            frame,
            self.model,
            self._layout,
            self._detector,
            config.method,
            config.corners,
            config.target,
            self._memory,
        )


class PixelView:
    """Implements ``drivers.interfaces.View`` on one frame. Every question is answered from the
    pixels when asked.
    """

    __slots__ = (
        "_corners",
        "_detector",
        "_frame",
        "_layout",
        "_memory",
        "_method",
        "_model",
        "_size",
    )

    def __init__(
        self,
        frame: Frame,
        model: CameraModel,
        layout: MarkerLayout,
        detector: Detector,
        method: MethodConfig,
        corners: Corners = "photometric",
        size: TargetSize | None = None,
        memory: Memory | None = None,
    ) -> None:
        self._frame = frame
        self._model = model
        self._layout = layout
        self._detector = detector
        self._method = method
        self._corners: Corners = corners
        self._size = size  # of the target, in place of a depth stream
        self._memory = memory  # of the camera's earlier views

    @property
    def stamp_ns(self) -> int:
        return self._frame.stamp_ns

    @property
    def frame_id(self) -> int:
        return self._frame.frame_id

    def targets(self, region: Region | None) -> Sequence[Detection]:
        """Target-like objects with their box centre in ``region``, best score first.

        With a depth stream, only those that are not known to be nearer or farther than the region
        says. What touches them in the image, at another depth, is cut off; what is left of other
        things by that is odd in shape.
        """
        frame = self._frame
        detector = self._detector
        if region is None or region.any_depth:
            return detector.detect(frame.color, region)
        if frame.depth_mm is None:
            return self._by_size(region)
        near_m = region.near_m - DEPTH_SIGMAS * depth_sigma(region.near_m, self._method)
        far_m = region.far_m + DEPTH_SIGMAS * depth_sigma(region.far_m, self._method)
        if getattr(detector, "whole_image", False):
            found = detector.detect(frame.color, region)
            return [
                each
                for each in found
                if (z := self.depth(each.box)) is None or near_m <= z.z_m <= far_m
            ]
        depths = DepthSlice(frame.depth_mm, (near_m, far_m), self._method.depth_sigma_at_1m_m)
        shown = without_elsewhere(
            frame.color, depths.depth_mm, depths.limits_m, depths.sigma_at_1m_m, region
        )
        cut = depths.united(detector.detect(shown, region))
        found = detector.detect(frame.color, region) if cut else ()
        kept = [whole if (whole := _whole_of(each, found)) is not None else each for each in cut]
        sure = [each for each in kept if each in found or each.score >= CUT_SCORE]
        return sure or [each for each in kept if depths.is_thing(each)]

    def markers(
        self, region: Region | None, expected: Pose | None = None
    ) -> Sequence[MarkerDetection]:
        """Markers of the layout in ``region``, looked for first where they are expected."""
        return detect_markers(
            self._frame.color,
            region,
            self._layout,
            self._model,
            refine=self._corners,
            expected=expected,
            memory=self._memory,
        )

    def depth(self, box: Box) -> Depth | None:
        """Robust depth over a box (``path.target.place``); without a depth stream, by the target's
        size.
        """
        depth_mm = self._frame.depth_mm
        if depth_mm is not None:
            return registered_depth(depth_mm, box, self._method)
        return None if self._size is None else monocular_range(box, self._model, self._size)

    def image(self) -> Image:
        return self._frame.color

    @property
    def frame(self) -> Frame:
        return self._frame

    def _by_size(self, region: Region) -> Sequence[Detection]:
        """Those that can be as far away as the region says, by the target's size; all where that is
        not known.
        """
        size = self._size
        if size is not None and size.longest_m > 0.0 and region.far_m < math.inf:
            z_m = 0.5 * (region.near_m + region.far_m)
            focal_px = max(self._model.fx, self._model.fy)
            region = replace(region, extent=extent_at(z_m, focal_px, size))
        found = self._detector.detect(self._frame.color, region)
        return [each for each in found if self._may_be_within(region, each.box)]

    def _may_be_within(self, region: Region, box: Box) -> bool:
        """Return whether a target in this box can be as far away as the region says; yes where
        that is not known.
        """
        if max(box.w, box.h) > region.extent.longest_px:
            return False
        depth = None if self._size is None else monocular_range(box, self._model, self._size)
        if depth is None:  # the image's border cuts the box: the object is at least as large
            return True
        reach_m = RANGE_SIGMAS * depth.sigma_m
        return region.near_m - reach_m <= depth.z_m <= region.far_m + reach_m


def _whole_of(part: Detection, found: Sequence[Detection]) -> Detection | None:
    """The same thing where nothing is cut off, and its edges are exact; None when there was
    something to cut off.
    """
    whole = max(found, key=lambda each: iou(each.box, part.box), default=None)
    return whole if whole is not None and iou(whole.box, part.box) >= UNCUT_IOU else None


def _check_size(frame: Frame, model: CameraModel) -> None:
    for kind, size in frame.sizes.items():
        check_size((model.width, model.height), size, f"{kind} stream")
