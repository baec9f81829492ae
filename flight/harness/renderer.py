"""Pictures of known truth, for measuring perception: the stage, the camera that looks at it, and
who draws it.

A trial arranges a stage and shoots it; the rig names the renderer (``[trials] renderer``). World
frame ``w`` is ENU, the ground at z = 0. All values are the truth: what a trial lets the method
believe (calibration, printed size, attitude) is the trial's own choice of errors.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import field, replace
from typing import Annotated, Literal, Protocol

from path.arrays import Depths, Image
from path.bounds import Bounds, out_of_bounds
from path.camera.model import CameraModel
from path.geometry.transforms import Pose
from path.marker.layout import MarkerLayout
from path.messages import Role, Vec3
from path.values import frozen

Kind = Literal["car", "person"]

FARTHEST_PX = 100.0  # that a camera moves during its exposure


@frozen
class Thing:
    """An object on the ground. Its frame: x forward, z up, origin on the ground below its middle.

    Attributes:
        yaw_rad: counter-clockwise from east.
        variant: objects of one kind differ a little by it, as similar people do.
    """

    kind: Kind
    position_w_m: Vec3
    yaw_rad: float = 0.0
    variant: int = 0


@frozen(eq=False)
class PlacedBoard:
    """A flat printed board. Its frame: x right and y down as printed, z away from who reads it.

    Attributes:
        T_w_o: the board's frame, origin at the top-left corner of the print, to the world.
        side_m: of one cell of the print.
        print_shades: uint8 (rows, columns), one a cell, 255 white paper and 0 ink.
        light: of ink and of paper, 0..255 linear.
    """

    T_w_o: Pose
    side_m: float
    print_shades: Image
    light: tuple[float, float] = (26.0, 228.0)


@frozen
class RenderedInstant:
    """The things that there are at one instant.

    Attributes:
        T_w_b: body FRD of each drone to the world; a drone that is not named is not there.
        rotor_phase_rad: turns the drawn blades.
        marker_hidden: the plates are blank.
    """

    T_w_b: Mapping[Role, Pose]
    things: tuple[Thing, ...] = ()
    rotor_phase_rad: float = 0.0
    marker_hidden: bool = False
    boards: tuple[PlacedBoard, ...] = ()


@frozen
class Imaging:
    """A camera's imaging of the light it gets. The default is a sensor that is linear and
    uncompressed.

    What is done comes in this order: blur, motion, exposure, mosaic, noise, interpolation of the
    mosaic, gamma, sharpening, 8 bit, YUYV, compression.

    Attributes:
        blur_sigma_px: Gaussian blur of the optics.
        read_sigma, shot_gain: noise, grey levels; and variance in grey levels squared per grey
            level.
        exposure: factor on the light; above 1 white paper saturates.
        motion_px: length and direction of the motion during the exposure, (u, v) px.
        mosaic: the light is sampled through a Bayer pattern and interpolated again.
        gamma: the image is light to the power of 1 / gamma.
        sharpen, sharpen_sigma_px: unsharp mask: share of the difference to the blurred image that
            is added.
        jpeg_quality: 1..100, None for no JPEG.
        h264_crf: 0..51 constant rate factor, None for no H.264.
        yuyv: delivered as YUYV, colour at half the width, as USB cameras do without compression;
            the sharpening is of brightness alone.

    Raises:
        ValueError: naming the field that cannot be right.
    """

    blur_sigma_px: Annotated[float, Bounds(0.0, 20.0)] = 0.6
    read_sigma: Annotated[float, Bounds(0.0, 100.0, "grey levels")] = 1.2
    shot_gain: Annotated[float, Bounds(0.0, 10.0, "grey levels")] = 0.015
    exposure: Annotated[float, Bounds(1e-3, 100.0, "times")] = 1.0
    motion_px: Annotated[tuple[float, float], Bounds(-FARTHEST_PX, FARTHEST_PX)] = (0.0, 0.0)
    mosaic: bool = False
    gamma: Annotated[float, Bounds(1e-3, 20.0, "(an exponent)")] = 1.0
    sharpen: Annotated[float, Bounds(0.0, 50.0, "times")] = 0.0
    sharpen_sigma_px: Annotated[float, Bounds(1e-3, 20.0)] = 1.0
    jpeg_quality: Annotated[int | None, Bounds(1, 100, "(a quality)")] = None
    h264_crf: Annotated[int | None, Bounds(0, 51, "(a rate factor)")] = None
    yuyv: bool = False

    def __post_init__(self) -> None:
        for name, why in out_of_bounds(self):
            raise ValueError(f"{name}: {why}")
        if math.hypot(*self.motion_px) > FARTHEST_PX:
            raise ValueError(f"motion_px: {self.motion_px!r} is more than {FARTHEST_PX:g} px long")


IDEAL = Imaging()
REALISTIC = Imaging(mosaic=True, gamma=2.2, sharpen=1.0, sharpen_sigma_px=1.1, jpeg_quality=90)
"""A webcam. Beside the edges of a print its halo is 12 % of the contrast on black and 9 % on white;
on a photograph of a marker board it is 15 % and 6 %."""
REALISTIC_VIDEO = replace(REALISTIC, jpeg_quality=None, h264_crf=23)
"""The same camera, streamed as H.264."""
WEBCAM = replace(REALISTIC, blur_sigma_px=0.4, sharpen=1.5)
"""A sharper one. The photometric fit leaves 7 % of the contrast unexplained, and 4 to 5 % with
``REALISTIC``; on a photograph of a marker board it leaves 8 %."""


@frozen
class Printing:
    """The imperfections of the printed marker.

    Attributes:
        ink_spread_m: how far black reaches beyond its edges.
        black_spread: standard deviation of black over the cells, grey levels of the light.
        shadow: "none", "soft" (a gradient of light across the plate) or "hard" (an edge of shadow
            across it).
        blade: a rotor blade is before the plate, blurred by its own motion.
        picture_px: pixels across the marker in the picture that was printed, in which every cell
            ends with a whole one as OpenCV draws it; 0 for exact edges. The outer edges of the
            black frame are exact either way.

    Raises:
        ValueError: naming the field that cannot be right.
    """

    ink_spread_m: Annotated[float, Bounds(0.0, 0.01)] = 0.0
    black_spread: Annotated[float, Bounds(0.0, 255.0, "grey levels")] = 0.0
    shadow: Literal["none", "soft", "hard"] = "none"
    blade: bool = False
    picture_px: Annotated[int, Bounds(0, 100_000)] = 0

    def __post_init__(self) -> None:
        for name, why in out_of_bounds(self):
            raise ValueError(f"{name}: {why}")


PRINTED = Printing(ink_spread_m=0.0001, black_spread=4.0)
"""An ordinary print: ink a tenth of a millimetre over its edges, black that is not flat."""


@frozen
class DepthNoise:
    """Noise of the depth camera; ``sigma_at_1m_m`` grows with the square of the depth."""

    sigma_at_1m_m: float = 0.005
    correlation_px: float = 1.0
    hole_rate: float = 0.25
    min_m: float = 0.3
    max_m: float = 6.0


@frozen
class RendererSetup:
    """One drone's camera, as it truly is, and the markers on the sender, as they truly are."""

    camera: CameraModel
    T_b_c: Pose
    T_b_v: Pose
    layout: MarkerLayout
    imaging: Imaging = field(default_factory=Imaging)
    printing: Printing = field(default_factory=Printing)
    depth: DepthNoise = field(default_factory=DepthNoise)


@frozen
class Shot:
    """``color``: uint8 (h, w, 3) BGR. ``depth_mm``: uint16 (h, w), registered to it, 0 where there
    is none.
    """

    color: Image
    depth_mm: Depths


class FrameRenderer(Protocol):
    """Shoots stages with one camera. The same setup, stage and seeds give the same bytes."""

    def __init__(self, setup: RendererSetup, seed: int) -> None: ...

    def shoot(
        self,
        stage: RenderedInstant,
        role: Role,
        shot_seed: int,
    ) -> Shot:
        """Return the image that the role's camera delivers."""
        ...

    def true_depth_m(
        self,
        stage: RenderedInstant,
        role: Role,
        u: float,
        v: float,
    ) -> float | None:
        """Exact depth along the optical axis of the surface seen at a pixel; None when there is
        none in reach.
        """
        ...
