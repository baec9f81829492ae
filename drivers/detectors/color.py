"""A classical detector for saturated-colour vehicles: it needs no weights and looks at pixels
alone.

A coarse pass on every ``coarse_step``-th pixel finds connected patches of the wanted colour, and
the dark parts (tires, glass) that touch them; each is then measured at full resolution, its edges
placed where the colour is half way between object and surroundings.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.detectors.color_patches import (
    CROSS,
    Image,
    Patch,
    Shape,
    components,
    divide,
    in_pixels_of,
    join,
    shape_of,
    split,
    with_dark,
)
from path.bounds import Bounds
from path.observations import UNKNOWN, Box, Detection, Extent, Region
from path.values import frozen

RAGGED = 0.25  # solidity that an outline may lose to coarse pixels, times the patch's size in them


@frozen
class ColorDetectorConfig:
    """The colour, sizes and shapes that count as a vehicle.

    Attributes:
        hue_deg: centre of the wanted hue (0 red, 120 green); ``hue_halfwidth_deg`` 180 takes every
            hue.
        min_saturation, min_value: 0..1 (HSV); below, a pixel is not of the wanted colour.
        dark_value: pixels darker than this (0..1) belong to the vehicle whose colour they touch.
        dark_reach: how far dark parts may stick out, as a fraction of the size of the coloured
            patch.
        coarse_step: pixels between the samples of the coarse pass.
        min_side_px, max_side_px: limits of the longer side of a box, in the image as given.
            ``max_side_px`` also says how far outside a search region an object with its centre
            inside can reach.
        merge_gap: coloured parts of one vehicle may be this fraction of its size apart.
        split_solidity: a patch that fills less of its convex hull than this is cut at its waist,
            when it has one, into two vehicles that touch.
        odd_solidity: one that fills even less and has no waist is not taken for a whole vehicle, or
            for only one.
        max_aspect: a patch longer than this many times its width is taken for vehicles in line.
        odd_score: factor on the score of what is odd in shape.
        border_score: factor on the score of a box that the image border cuts: it is not the
            object's box.
    """

    hue_deg: Annotated[float, Bounds(0.0, 360.0)] = 26.0
    hue_halfwidth_deg: Annotated[float, Bounds(0.0, 180.0)] = 18.0
    min_saturation: Annotated[float, Bounds(0.0, 1.0, "of 1")] = 0.5
    min_value: Annotated[float, Bounds(0.0, 1.0, "of 1")] = 0.2
    dark_value: Annotated[float, Bounds(0.0, 1.0, "of 1")] = 0.2
    dark_reach: Annotated[float, Bounds(0.0, 5.0, "of 1")] = 0.4
    coarse_step: Annotated[int, Bounds(1, 64, "px")] = 4
    min_side_px: Annotated[float, Bounds(1.0, 4000.0)] = 10.0
    max_side_px: Annotated[float, Bounds(1.0, 16384.0)] = 300.0
    merge_gap: Annotated[float, Bounds(0.0, 5.0, "of 1")] = 0.10
    split_solidity: Annotated[float, Bounds(0.0, 1.0, "of 1")] = 0.82
    odd_solidity: Annotated[float, Bounds(0.0, 1.0, "of 1")] = 0.80
    max_aspect: Annotated[float, Bounds(1.0, 100.0, "of 1")] = 2.2
    odd_score: Annotated[float, Bounds(0.0, 1.0, "of 1")] = 0.3
    border_score: Annotated[float, Bounds(0.0, 1.0, "of 1")] = 0.2


class ColorDetector:
    """Implements ``drivers.interfaces.Detector``. Stateless between calls."""

    Config = ColorDetectorConfig

    def __init__(self, config: ColorDetectorConfig, context: object | None = None) -> None:
        del context  # made like every part of a rig, but needs nothing of the role
        self._config = config
        self._ranges = _hue_ranges(config)
        self._dark = round(config.dark_value * 255)

    def detect(self, image: NDArray[np.uint8], region: Region | None) -> Sequence[Detection]:
        """Boxes of vehicles, best score first.

        Args:
            image: (h, w, 3) uint8 BGR.
            region: only objects whose box centre is inside; None for the whole image. What is
                larger than its ``extent`` is cut into those that touch in it, where it has a dent;
                what is smaller is one.
        """
        height, width = image.shape[:2]
        step = self._config.coarse_step
        window = _window(region, self._config.max_side_px / 2, width, height, step)
        if window is None:
            return ()
        x0, y0, x1, y1 = window
        # Nearest neighbour at exactly 1/step takes the pixels (i * step, j * step).
        size = ((x1 - x0) // step, (y1 - y0) // step)
        small = cv2.resize(
            image[y0 : y0 + size[1] * step, x0 : x0 + size[0] * step],
            size,
            None,
            0,
            0,
            cv2.INTER_NEAREST,
        )
        hsv = cv2.cvtColor(small, cv2.COLOR_BGR2HSV)
        colored = self._colored(hsv)
        dark = cv2.inRange(hsv, (0, 0, 0), (180, 255, self._dark))
        found: list[Detection] = []
        extent = UNKNOWN if region is None else in_pixels_of(step, region.extent)
        for patch in self._patches(colored, extent.longest_px):
            if region is not None and not _may_reach(patch, region, x0, y0, step):
                continue
            for piece, whole, shape in self._vehicles(patch, dark, colored, extent):
                if region is not None and not _may_be_inside(piece, region, x0, y0, step):
                    continue
                box = self._measure(image, whole, self._cover_tables(hsv, piece, whole), x0, y0)
                if box is not None and (region is None or region.contains(*box.center)):
                    found.append(Detection(box, self._score(box, piece, shape, width, height)))
        found.sort(key=lambda d: (-d.score, d.box.x, d.box.y))
        return found

    def _colored(self, hsv: Image) -> Image:
        """Mask of pixels of the wanted colour (0 or 255)."""
        mask = cv2.inRange(hsv, *self._ranges[0])
        for low, high in self._ranges[1:]:
            mask = cv2.bitwise_or(mask, cv2.inRange(hsv, low, high))
        return mask

    def _patches(self, colored: Image, longest: float) -> list[Patch]:
        """Patches of the wanted colour, the parts of one vehicle joined."""
        patches = join(components(colored), self._config.merge_gap, longest)
        smallest = 0.5 * self._config.min_side_px / self._config.coarse_step
        return [p for p in patches if max(p.w, p.h) >= smallest]

    def _vehicles(
        self, patch: Patch, dark: Image, colored: Image, extent: Extent
    ) -> list[tuple[Patch, Patch, Shape]]:
        """Coloured part, whole with dark parts, and shape of the whole: of one vehicle, or of those
        that touch.
        """
        pieces = divide(patch, extent)
        if len(pieces) == 1:
            whole = self._with_dark(patch, dark, colored, extent)
            shape = shape_of(whole.mask)
            small = math.sqrt(patch.w * patch.h) < extent.usual_px
            pieces = (
                [patch] if small or shape.solidity >= self._config.split_solidity else split(patch)
            )
            if len(pieces) == 1:
                return [(patch, whole, shape)]
        wholes = [(piece, self._with_dark(piece, dark, colored, extent)) for piece in pieces]
        return [(piece, w, shape_of(w.mask)) for piece, w in wholes]

    def _with_dark(self, piece: Patch, dark: Image, colored: Image, extent: Extent) -> Patch:
        """A coloured part with the dark ones that touch it, unless those make it longer than one
        vehicle can be.
        """
        whole = with_dark(piece, dark, colored, self._config.dark_reach)
        return whole if max(whole.w, whole.h) <= extent.longest_px else piece

    def _cover_tables(self, hsv: Image, piece: Patch, whole: Patch) -> tuple[Image, Image]:
        """Tables from a pixel's saturation, and from its value, to how much of it (0..255) the
        vehicle covers.

        What vehicle and surroundings look like is taken from the coarse samples around it.
        """
        inside = hsv[piece.y : piece.y + piece.h, piece.x : piece.x + piece.w]
        around = hsv[whole.y : whole.y + whole.h, whole.x : whole.x + whole.w]
        ground = cv2.mean(around, cv2.bitwise_not(whole.mask))
        saturation = cv2.mean(inside, piece.mask)[1]
        by_color = _ramp(min(ground[1], 0.8 * saturation), saturation)
        return by_color, _ramp(max(min(ground[2], 1.75 * self._dark), self._dark), 0.6 * self._dark)

    def _measure(
        self, image: Image, whole: Patch, tables: tuple[Image, Image], left: int, top: int
    ) -> Box | None:
        """Refine a coarse patch, found in a window at ``left, top`` of the image, to a box with
        interpolated edges.
        """
        step = self._config.coarse_step
        height, width = image.shape[:2]
        gate = cv2.dilate(
            cv2.copyMakeBorder(whole.mask, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=(0,)), CROSS
        )
        gate = cv2.resize(gate, None, fx=step, fy=step, interpolation=cv2.INTER_NEAREST)
        # A coarse pixel stands for the block around its sample, hence the shift by half a block.
        gx = left + (whole.x - 1) * step - step // 2
        gy = top + (whole.y - 1) * step - step // 2
        x0 = max(gx, 0)
        y0 = max(gy, 0)
        x1 = min(gx + gate.shape[1], width)
        y1 = min(gy + gate.shape[0], height)
        gate = gate[y0 - gy : y1 - gy, x0 - gx : x1 - gx]
        hsv = cv2.cvtColor(image[y0:y1, x0:x1], cv2.COLOR_BGR2HSV)
        by_color = cv2.LUT(cv2.extractChannel(hsv, 1), tables[0])
        by_darkness = cv2.LUT(cv2.extractChannel(hsv, 2), tables[1])
        cover = cv2.bitwise_and(cv2.max(by_color, by_darkness), gate)
        across = _edges(cover.max(axis=0))
        down = _edges(cover.max(axis=1))
        if across is None or down is None:
            return None
        box = Box(x0 + across[0], y0 + down[0], across[1] - across[0], down[1] - down[0])
        return (
            box
            if self._config.min_side_px <= max(box.w, box.h) <= self._config.max_side_px
            else None
        )

    def _score(self, box: Box, piece: Patch, shape: Shape, width: int, height: int) -> float:
        """1 for a compact patch of colour that fills its box; low for what is no whole vehicle, or
        more than one.
        """
        config = self._config
        colored = cv2.countNonZero(piece.mask) * config.coarse_step**2
        score = shape.solidity * min(1.0, colored / (0.2 * box.area))
        # A small patch has a ragged outline: its shape is not known so well.
        if (
            shape.aspect > config.max_aspect
            or shape.solidity < config.odd_solidity - RAGGED / piece.size
        ):
            score *= config.odd_score
        if (
            box.x < 0.0
            or box.y < 0.0
            or box.x + box.w > width - 1.0
            or box.y + box.h > height - 1.0
        ):
            score *= config.border_score
        return score


_LEVELS = np.arange(256, dtype=np.float64)


def _ramp(background: float, thing: float) -> Image:
    """Table from a channel's level to the share (0..255) of ``thing`` in a mixture with
    ``background``.
    """
    return np.clip((_LEVELS - background) * (255.0 / (thing - background)), 0.0, 255.0).astype(
        np.uint8
    )


def _hue_ranges(config: ColorDetectorConfig) -> list[tuple[Image, Image]]:
    """HSV bounds in OpenCV units (hue in half degrees); two of them when the hue window wraps
    around red.
    """
    saturation = round(config.min_saturation * 255)
    value = round(config.min_value * 255)

    def bounds(low: float, high: float) -> tuple[Image, Image]:
        return (
            np.array([round(low / 2), saturation, value], np.uint8),
            np.array([min(round(high / 2), 179), 255, 255], np.uint8),
        )

    if config.hue_halfwidth_deg >= 180:
        return [bounds(0, 360)]
    low = config.hue_deg - config.hue_halfwidth_deg
    high = config.hue_deg + config.hue_halfwidth_deg
    if low < 0:
        return [bounds(0, high), bounds(low + 360, 360)]
    if high >= 360:
        return [bounds(low, 360), bounds(0, high - 360)]
    return [bounds(low, high)]


def _window(
    region: Region | None, reach_px: float, width: int, height: int, step: int
) -> tuple[int, int, int, int] | None:
    """The part of the image to look at, ``x0 y0 x1 y1`` with its corner on a multiple of
    ``step``.
    """
    if region is None:
        return 0, 0, width, height
    if region.clipped(width, height) is None:
        return None
    x0 = max(int(region.x0 - reach_px) // step * step, 0)
    y0 = max(int(region.y0 - reach_px) // step * step, 0)
    return (
        x0,
        y0,
        min(int(region.x1 + reach_px) + 1, width),
        min(int(region.y1 + reach_px) + 1, height),
    )


def _may_reach(patch: Patch, region: Region, left: int, top: int, step: int) -> bool:
    """Return whether a part of the patch can have its centre in the region: it may be two vehicles
    that touch.
    """
    x0 = left + (patch.x - 0.5) * step
    y0 = top + (patch.y - 0.5) * step
    x1 = x0 + patch.w * step
    y1 = y0 + patch.h * step
    return region.x0 < x1 and x0 < region.x1 and region.y0 < y1 and y0 < region.y1


def _may_be_inside(patch: Patch, region: Region, left: int, top: int, step: int) -> bool:
    """Return whether the centre of the patch, known to about a coarse pixel, can lie in the
    region.
    """
    u = left + (patch.x + patch.w / 2) * step
    v = top + (patch.y + patch.h / 2) * step
    slack = 2.0 * step
    return region.x0 - slack <= u < region.x1 + slack and region.y0 - slack <= v < region.y1 + slack


def _edges(profile: Image) -> tuple[float, float] | None:
    """Return where a profile (0..255) first rises and last falls through half, interpolated
    between pixel centres.
    """
    above = np.flatnonzero(profile >= 128)
    if len(above) == 0:
        return None
    return _crossing(profile, int(above[0]), -1), _crossing(profile, int(above[-1]), +1)


def _crossing(profile: Image, at: int, outward: int) -> float:
    inner = float(profile[at])
    beyond = at + outward
    if not 0 <= beyond < len(profile):
        return at + 0.5 * outward
    return at + outward * (inner - 127.5) / (inner - float(profile[beyond]))
