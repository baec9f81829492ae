"""A photometric fit on its way: its state, what it starts from, and its Gauss-Newton passes, first
with the 16 unknowns of an ideal print and camera, then with those of ``misfit`` too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from path.camera.kernels import lens_of
from path.camera.model import CameraModel
from path.marker.kernels import Array
from path.marker.photometric.kernels import (
    START_BLUR_PX,
    Statistics,
    robust_scale,
    statistics,
    step,
    tones,
)
from path.marker.photometric.misfit import (
    EDGE_SIGMA,
    FILTERED,
    GROUPS,
    SHADOW,
    TAPS,
    Flags,
    Indices,
    Places,
    accumulate_filtered,
    model,
    own_places,
    stencil,
    used_unknowns,
)
from path.marker.photometric.pattern import BLUR, UNKNOWNS, accumulate
from path.marker.photometric.print_pixels import MAX_PIXELS, Gray, frame_of, gather, homography

MAX_PASSES = 8
FIRST_PIXELS = 600  # for the first pass from a near start, which only leads nearer
# residual over contrast above which it is asked what is wrong
MISFIT = 0.025
CORRELATED_MISFIT = 0.011
SHARE_USED = 0.84  # mean weight below which something lies across the print, or much more is wrong
NEAR_PX = 0.1  # a step shorter than this leads near enough to ask what is wrong
MAX_DRIFT_PX = 3.0  # a step longer than this is not a refinement
REGATHER_PX = 0.2  # after a step longer than this the pixels of the print are chosen anew
SETTLED_PX = 0.03  # a step shorter than this is followed by none that matters


@dataclass(slots=True)
class FitState:
    """A fit on its way: first of 16 unknowns ``theta``, then of those in ``groups`` of ``extra``
    too.
    """

    image: Gray
    offset: tuple[int, int]
    cells: Array
    edges: Array  # (2, n + 1)
    lens: Array
    frame: Array
    theta: Array
    corners: Array
    pixels: Array
    extra: Array
    groups: Flags
    border: bool
    edge_sigma: float = EDGE_SIGMA
    jacobian: Array = field(default_factory=lambda: np.empty((8, 8)))
    factor: Array = field(default_factory=lambda: np.empty((0, 0)))
    residuals: Array = field(default_factory=lambda: np.empty(0))
    noise: float = 0.0
    spread: float = 1e3
    moved: float = math.inf
    passes: int = 0
    measured: Statistics | None = None  # of these residuals, once asked for

    def copy(self) -> FitState:
        """Return a copy with unknowns of its own."""
        return replace(
            self,
            theta=self.theta.copy(),
            corners=self.corners.copy(),
            extra=self.extra.copy(),
            groups=self.groups.copy(),
            jacobian=self.jacobian.copy(),
        )

    @property
    def n(self) -> int:
        return self.cells.shape[0] - 2

    @property
    def statistics(self) -> Statistics:
        known = self.measured
        if known is None:
            known = self.measured = statistics(
                self.pixels,
                self.residuals,
                self.spread,
                len(self.factor),
            )
        return known

    @property
    def area_px2(self) -> float:
        x, y = self.corners.T
        scale = abs(self.frame[5] * self.frame[8] - self.frame[6] * self.frame[7])
        return (
            0.5
            * abs(float((x[0] - x[2]) * (y[1] - y[3]) - (x[1] - x[3]) * (y[0] - y[2])))
            / float(scale)
        )

    @property
    def share_used(self) -> float:
        """Mean weight of the pixels that are not saturated, 0.88 when the residuals are normal."""
        return self.statistics[0] / max(np.count_nonzero(self.residuals), 1)

    def loss(self, spread: float) -> float:
        """Size of the residuals, those far beyond ``spread`` counted as that large."""
        squares = self.residuals**2
        return math.sqrt(float(np.mean(squares / (1.0 + squares / spread**2))))

    @property
    def edges_off(self) -> float:
        """By how much the inner edges are off, rms in cells."""
        return math.sqrt(float(np.mean(self.extra[TAPS:-SHADOW] ** 2)))

    @property
    def misfit(self) -> float:
        """Residual over contrast."""
        return math.sqrt(self.statistics[1]) / max(abs(float(self.theta[11])), 1.0)

    @property
    def correlated_misfit(self) -> float:
        return self.misfit * math.sqrt(self.statistics[3])

    def gather(
        self,
        blur_px: float,
        most: int = MAX_PIXELS,
        block: int = 0,
    ) -> bool:
        """Choose the pixels; False when there are too few."""
        u, v = self.offset
        frame = self.frame
        lens = self.lens
        theta = self.theta
        self.measured = None
        self.pixels = gather(
            self.image,
            u,
            v,
            frame,
            lens,
            theta,
            self.n,
            blur_px,
            self.border,
            most,
            block,
        )
        return len(self.pixels) >= 3 * UNKNOWNS


def start(
    image: Gray,
    offset: tuple[int, int],
    start_px: Array,
    camera: CameraModel,
    cells: Array,
    edges: Array | None,
    first_pixels: int,
    border: bool,
) -> FitState | None:
    n = cells.shape[0] - 2
    lens = lens_of(camera)
    frame = np.empty(9)
    rays = np.empty((4, 2))
    theta = np.zeros(UNKNOWNS)
    theta[BLUR] = START_BLUR_PX
    if not frame_of(start_px, lens, frame, rays) or not homography(rays, n, theta):
        return None
    ends = np.repeat(np.arange(n + 1.0)[None], 2, axis=0) if edges is None else edges
    extra = np.zeros(TAPS + 2 * (n - 1) + SHADOW)
    groups = np.zeros(GROUPS, np.bool_)
    state = FitState(
        image,
        offset,
        cells,
        ends,
        lens,
        frame,
        theta,
        rays,
        np.empty((0, 6)),
        extra,
        groups,
        border,
    )
    if not state.gather(START_BLUR_PX, first_pixels):
        return None
    theta[8], theta[11] = tones(state.pixels)
    return state


def fit_ideal(
    state: FitState,
    ideal: bool,
    few: bool = False,
    settled_px: float = SETTLED_PX,
) -> bool:
    """Passes with the 16 unknowns of an ideal print and camera; False when they drift away or off
    the print.

    ``few``: the first pass has few pixels.
    """
    normal = np.empty((UNKNOWNS, UNKNOWNS + 1))
    used = np.empty(0, np.int64)
    sigmas = np.empty(0)
    for _ in range(MAX_PASSES):
        state.residuals = np.empty(len(state.pixels))
        accumulate(
            state.pixels,
            state.theta,
            state.frame,
            state.cells,
            state.edges,
            state.spread,
            normal,
            state.residuals,
        )
        if not _step(state, normal, used, sigmas):
            return False
        first = state.passes == 1
        if not first and (
            state.moved < settled_px or (not ideal and state.moved < NEAR_PX and _is_wrong(state))
        ):
            break
        if ((first and few) or state.moved > REGATHER_PX) and not state.gather(state.theta[BLUR]):
            return False
    return True


def misfits(state: FitState) -> bool:
    """Return whether an ideal print and camera fail to explain the image: to be asked near the end
    of their fit.
    """
    return not explained(state) or state.share_used < SHARE_USED


def explained(state: FitState) -> bool:
    """Return whether an ideal print and camera leave little of the pixels that count, whatever
    lies across others.
    """
    return state.misfit < MISFIT and state.correlated_misfit < CORRELATED_MISFIT


def _is_wrong(state: FitState) -> bool:
    """Return whether it can be told already that something other than what lies across the print
    is not ideal.
    """
    return misfits(state) and state.share_used > SHARE_USED


def places(state: FitState) -> tuple[Array, Indices]:
    return (
        stencil(state.pixels, state.frame, state.lens)
        if state.groups[FILTERED]
        else own_places(state.pixels)
    )


def misfit_pass(
    state: FitState,
    rays: Array,
    at: Indices,
) -> bool:
    used, sigmas = used_unknowns(state.groups, state.n, state.edge_sigma)
    normal = np.empty((UNKNOWNS + len(used), UNKNOWNS + len(used) + 1))
    state.residuals = np.empty(len(state.pixels))
    rows = model(
        rays,
        state.theta,
        state.extra,
        state.groups,
        state.frame,
        state.cells,
        state.edges,
    )
    taps = state.extra[:TAPS]
    filtered = bool(state.groups[FILTERED])
    accumulate_filtered(
        state.pixels,
        at,
        rows,
        taps,
        filtered,
        state.spread,
        normal,
        state.residuals,
    )
    return _step(state, normal, used, sigmas)


def _step(
    state: FitState,
    normal: Array,
    used: Places,
    sigmas: Array,
) -> bool:
    """Change the unknowns; False when that leads away from the start."""
    state.noise = robust_scale(state.residuals)
    state.spread = 4.0 * state.noise
    state.measured = None
    state.factor = np.empty((len(normal), len(normal)))
    state.passes += 1
    state.moved = step(
        normal,
        state.noise,
        state.frame,
        state.n,
        state.theta,
        state.extra,
        used,
        sigmas,
        state.factor,
        state.corners,
        state.jacobian,
    )
    return state.moved < MAX_DRIFT_PX
