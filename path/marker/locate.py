"""One image to the pose of a marker: everything of this package behind one function, for use on its
own.

See docs/marker.md for the frames and an example.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from path.camera.model import CameraModel
from path.geometry.transforms import Pose
from path.marker.detect import Refine, detect_markers
from path.marker.layout import MarkerLayout
from path.marker.photometric.known import Memory
from path.marker.pose import MarkerPose, PoseSettings, estimate_pose
from path.messages import Vec3
from path.observations import MarkerDetection, Missed, MissReason, Region
from path.values import value

# a region around a previous pose reaches this many sides of the markers' outline beyond it
REGION_SIDES = 1.0


@dataclass(frozen=True, slots=True)
class Gravity:
    """The direction of gravity in some frame.

    Attributes:
        direction: along gravity (down), of any length: an accelerometer at rest gives the opposite.
        sigma_rad: standard deviation of its angle per axis, biases included.

    Raises:
        ValueError: the direction has none, or the sigma is not positive.
    """

    direction: Vec3
    sigma_rad: float = math.radians(0.6)

    def __post_init__(self) -> None:
        length = math.hypot(*self.direction)
        if not (math.isfinite(length) and length > 1e-9):
            raise ValueError(f"direction: {self.direction!r} points nowhere")
        if not (math.isfinite(self.sigma_rad) and self.sigma_rad > 0.0):
            raise ValueError(f"sigma_rad: {self.sigma_rad!r} is not a positive angle")

    @property
    def unit(self) -> Vec3:
        x, y, z = self.direction
        length = math.hypot(x, y, z)
        return x / length, y / length, z / length


@value
class LocatedMarker(MarkerPose):
    """A pose, and the markers in the image that it was made from."""

    detections: tuple[MarkerDetection, ...]


def locate_marker(
    image: NDArray[np.uint8],
    camera: CameraModel,
    layout: MarkerLayout,
    *,
    gravity_v: Gravity | None = None,
    gravity_c: Gravity | None = None,
    region: Region | None = None,
    previous: Pose | None = None,
    memory: Memory | None = None,
    refine: Refine = "photometric",
    settings: PoseSettings | None = None,
) -> LocatedMarker | Missed:
    """Find the markers of a layout in an image and estimate where frame ``v`` is.

    Args:
        image: uint8, (height, width, 3) BGR or (height, width) grey, as the lens gives it (not
            undistorted).
        camera: its calibration, for images of this size.
        layout: the printed markers; ``single_marker(side_m)`` for one whose own frame is ``v``.
        gravity_v, gravity_c: down in ``v`` and in the camera's frame. They tell the two poses of a
            small planar marker apart, and how it is tilted; one without the other says nothing.
        region: where in the image to look; everywhere when None.
        previous: ``T_c_v`` in an image shortly before, instead of a region: there first, then
            everywhere. Where the marker is still within a cell of that place it is not searched for.
        memory: a dictionary, empty at first, that is given with every image of a film: what
            earlier ones told of print and camera, so that a fit takes a third of the time. The
            pose is still measured in this image alone.
        refine: "photometric", or "subpix" for OpenCV's corners with the covariance they deserve.
        settings: limits and errors; its attitude sigmas are replaced by those of ``gravity_v`` and
            ``gravity_c``.

    Returns:
        Missed NO_MARKER, MARKER_TWICE, MARKER_OBLIQUE, NON_FINITE, or POSE_UNCERTAIN: the two poses
        cannot be told apart (with ``max_ambiguity=1`` the likelier one is given), the corners do
        not fit, or the covariance is too large.

    Raises:
        ValueError: the image is not one of this camera.
    """
    if image.dtype != np.uint8 or image.shape not in (
        (camera.height, camera.width),
        (camera.height, camera.width, 3),
    ):
        raise ValueError(
            f"image: {image.dtype} {image.shape} is no uint8 image of {camera.width} x {camera.height} px, BGR or grey"
        )
    used = settings or PoseSettings()
    down_v = down_c = None
    if gravity_v is not None and gravity_c is not None:
        used = dataclasses.replace(
            used, attitude_v_sigma_rad=gravity_v.sigma_rad, attitude_c_sigma_rad=gravity_c.sigma_rad
        )
        down_v = gravity_v.unit
        down_c = gravity_c.unit
    located: LocatedMarker | Missed = Missed(MissReason.NO_MARKER)
    for area in _areas(region, previous, layout, camera):
        expected = previous if area is not None and region is None else None
        detections = detect_markers(
            image, area, layout, camera, refine=refine, expected=expected, memory=memory
        )
        pose = estimate_pose(detections, layout, camera, down_v, down_c, used)
        if isinstance(pose, MarkerPose):
            parts = {field.name: getattr(pose, field.name) for field in dataclasses.fields(pose)}
            return LocatedMarker(**parts, detections=detections)
        located = pose
        if detections:
            break
    return located


def _areas(
    region: Region | None, previous: Pose | None, layout: MarkerLayout, camera: CameraModel
) -> tuple[Region | None, ...]:
    """Return the regions to search for markers, in this order."""
    if region is not None or previous is None:
        return (region,)
    near = _around(previous, layout, camera)
    return (None,) if near is None else (near, None)


def _around(T_c_v: Pose, layout: MarkerLayout, camera: CameraModel) -> Region | None:
    """Return the region of the markers in the image, with room for motion; None when they would
    not be in it.
    """
    points_c = T_c_v.apply(np.concatenate([marker.corners_v for marker in layout.markers]))
    pixels = camera.project(points_c)
    if not np.all(np.isfinite(pixels)):
        return None
    (u0, v0), (u1, v1) = pixels.min(axis=0).tolist(), pixels.max(axis=0).tolist()
    room = REGION_SIDES * max(u1 - u0, v1 - v0)
    return Region(u0 - room, v0 - room, u1 + room, v1 + room).clipped(camera.width, camera.height)
