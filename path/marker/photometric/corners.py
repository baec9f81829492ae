"""Corners of a marker from a fit of its whole image, not of its edges.

Gauss-Newton with robust weights on the model of ``pattern``, an ideal print and camera. Where that
leaves more than noise, it is asked what is wrong, see ``misfit``. The normal matrix, the size of
the residual and how far it is correlated from pixel to pixel give the covariance of the corners:
what the model cannot explain is correlated, and counts for fewer pixels than it has.
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
    finish,
    robust_scale,
    statistics,
    step,
    tones,
)
from path.marker.photometric.misfit import (
    COARSE,
    EDGE_SIGMA,
    FILTERED,
    GROUPS,
    SHADOW,
    SHADOWED,
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
from path.marker.photometric.pattern import BLUR, TONE, UNKNOWNS, accumulate
from path.marker.photometric.print_pixels import MAX_PIXELS, Gray, frame_of, gather, homography
from path.marker.photometric.shadow import cell_light, find_shadow

MAX_PASSES = 8
FIRST_PIXELS = 600  # for the first pass from a near start, which only leads nearer
# with what may be wrong: a shadow or much, or little
MAX_MORE_PASSES = 6
MAX_FEW_PASSES = 2
MAX_COARSE_PASSES = 8  # with inner edges that may be off far
# residual over contrast that is worth all pixels and passes
STRONG_MISFIT = 0.055
STRONG_CORRELATED_MISFIT = 0.035
# side from which on less than that is not worth it: a pose is as good as print and lens are known
LARGE_PX = 42.0
# residual over contrast above which it is asked what is wrong
MISFIT = 0.025
CORRELATED_MISFIT = 0.011
# correlated misfit above which a shadow is looked for; share it may leave
SHADOW_MISFIT = 0.022
SHADOW_LEFT = 0.45
# in cells, and px: inner edges that are off by less may be exact
LEAST_OFF = 0.025
LEAST_OFF_PX = 0.12
COARSE_PASSES = 3  # with what is expected of inner edges, once that is known
# times the residual that counts, for a first pass: edges that are off seem to be outliers
COARSE_SPREAD = 2.0
WIDE_SPREAD = 4.0  # the same for all passes: edges that are off far
WIDE_LEFT = 0.80  # of the residual with outliers, that it may leave
# below which inner edges cannot be told from other things, such as a second marker close by
LEAST_CELL_PX = 2.8
LEAST_DEPTH = 0.1  # of a shadow
# of a lens and pixel; what is beyond it is left to the filter
LEAST_BLUR_PX = 0.5
MOST_BLUR_PX = 0.8
# pixels, and in squares of so many doublings: they share their surroundings
MAX_FILTERED = 1000
FILTERED_BLOCK = 2
# in deviations of blur that keep twice their size away from the plate's edge
FILTER_REACH_PX = 0.75
# residual over contrast that a filter may leave, and share of the ideal one's
FILTERED_MISFIT = 0.016
FILTERED_LEFT = 0.7
SHARE_USED = 0.84  # mean weight below which something lies across the print, or much more is wrong
NEAR_PX = 0.1  # a step shorter than this leads near enough to ask what is wrong
MAX_DRIFT_PX = 3.0  # a step longer than this is not a refinement
REGATHER_PX = 0.2  # after a step longer than this the pixels of the print are chosen anew
SETTLED_PX = 0.03  # a step shorter than this is followed by none that matters
UNSETTLED_PX = 0.15  # longest last step of a fit that creeps towards its end


@dataclass(frozen=True, slots=True)
class PhotometricFit:
    """Corners with what tells whether to trust them.

    Attributes:
        corners_px: shape (4, 2), distorted camera pixels.
        covariance_px2: shape (8, 8).
        residual: standard deviation of the robust residual, grey levels.
        contrast: white minus black at the centre, grey levels.
        blur_px: standard deviation of the blur, pixel area included.
        explained: share of the image's variance that the model explains, 0..1.
        passes: Gauss-Newton passes used.
        wrong: what the image said is not ideal: the camera (a filter), the print (its inner edges),
            light (a shadow).
    """

    corners_px: Array
    covariance_px2: Array
    residual: float
    contrast: float
    blur_px: float
    explained: float
    passes: int
    wrong: tuple[bool, ...] = (False,) * GROUPS


@dataclass(slots=True)
class _FitState:
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

    def copy(self) -> _FitState:
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
                self.pixels, self.residuals, self.spread, len(self.factor)
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

    def gather(self, blur_px: float, most: int = MAX_PIXELS, block: int = 0) -> bool:
        """Choose the pixels; False when there are too few."""
        u, v = self.offset
        frame = self.frame
        lens = self.lens
        theta = self.theta
        self.measured = None
        self.pixels = gather(
            self.image, u, v, frame, lens, theta, self.n, blur_px, self.border, most, block
        )
        return len(self.pixels) >= 3 * UNKNOWNS


def fit(
    image: Gray,
    offset: tuple[int, int],
    start_px: Array,
    camera: CameraModel,
    cells: Array,
    edges: Array | None = None,
    *,
    ideal: bool = False,
    near: bool = False,
    border: bool = True,
) -> PhotometricFit | None:
    """Fit the printed pattern to a grey image.

    Args:
        image: uint8, C-contiguous, shape (h, w); its pixel (0, 0) is the camera's pixel ``offset``.
        start_px: corners to start from, shape (4, 2), C-contiguous, distorted camera pixels, good
            to about a pixel.
        cells: pattern with a border of white cells, shape (cells + 2, cells + 2).
        edges: where the cells end along x and y, in cells from the frame's outer edge, shape (2,
            cells + 1); None for 0, 1, ..., cells.
        ideal: fit an ideal print and camera only.
        near: the corners to start from are good to half a pixel: the first pass looks at few
            pixels.
        border: there is a white border around the print; without one only what is within its frame
            is looked at.

    Returns:
        None when the fit does not converge or too few pixels show the print.
    """
    state = _start(
        image, offset, start_px, camera, cells, edges, FIRST_PIXELS if near else MAX_PIXELS, border
    )
    if state is None or not _fit_ideal(state, ideal, near):
        return None
    if not ideal and _misfits(state):
        state = (_settled(state) if near and _explained(state) else None) or _fit_misfit(state)
    return None if state.moved > UNSETTLED_PX else _finished(state)


def _start(
    image: Gray,
    offset: tuple[int, int],
    start_px: Array,
    camera: CameraModel,
    cells: Array,
    edges: Array | None,
    first_pixels: int,
    border: bool,
) -> _FitState | None:
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
    state = _FitState(
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


def _fit_ideal(state: _FitState, ideal: bool, few: bool = False) -> bool:
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
            state.moved < SETTLED_PX or (not ideal and state.moved < NEAR_PX and _is_wrong(state))
        ):
            break
        if ((first and few) or state.moved > REGATHER_PX) and not state.gather(state.theta[BLUR]):
            return False
    return True


def _misfits(state: _FitState) -> bool:
    """Return whether an ideal print and camera fail to explain the image: to be asked near the end
    of their fit.
    """
    return not _explained(state) or state.share_used < SHARE_USED


def _explained(state: _FitState) -> bool:
    """Return whether an ideal print and camera leave little of the pixels that count, whatever
    lies across others.
    """
    return state.misfit < MISFIT and state.correlated_misfit < CORRELATED_MISFIT


def _settled(state: _FitState) -> _FitState | None:
    """A fit that began near after one pass more; None when that does not explain the image either.

    Residuals are those before the last step, which was the first with all pixels: they may be of
    that step alone.
    """
    own = state.copy()
    return own if _fit_ideal(own, True) and not _misfits(own) else None


def _is_wrong(state: _FitState) -> bool:
    """Return whether it can be told already that something other than what lies across the print
    is not ideal.
    """
    return _misfits(state) and state.share_used > SHARE_USED


def _filter_pays(state: _FitState) -> bool:
    """Return whether a filter betters a pose: of a large marker only where much is wrong."""
    much = state.misfit > STRONG_MISFIT or state.correlated_misfit > STRONG_CORRELATED_MISFIT
    return much or state.area_px2 < LARGE_PX**2


def _fit_misfit(state: _FitState) -> _FitState:
    """The fit that knows what may be wrong, where that explains more than the ideal one; else that
    one, to its end.
    """
    better: _FitState | None = None
    if state.correlated_misfit > SHADOW_MISFIT:
        better = _tried(state, SHADOWED)
    if better is None or better.misfit > SHADOW_LEFT * state.misfit or better.noise > state.noise:
        better = _filtered_or_ideal(state)
    return _of_coarse_print(better) or better


def _of_coarse_print(state: _FitState) -> _FitState | None:
    """The fit whose inner edges are free, None where they are not off by more than noise makes
    them.

    They are found first, whatever they are; how far they are off together is what is then expected
    of each, the less the more the residual is correlated: as many pixels as it seems do not tell an
    edge.
    """
    cell_px = math.sqrt(state.area_px2) / state.n
    least = max(LEAST_OFF, LEAST_OFF_PX / cell_px)
    loose = _tried(state, COARSE, WIDE_SPREAD) if cell_px > LEAST_CELL_PX else None
    if loose is not None and loose.edges_off > least and not _leaves_less(loose, state):
        # what lies across a print moves edges too, and leaves as much as before
        loose = _tried(state, COARSE)
    if loose is None or loose.edges_off < least:
        return None
    own = loose.copy()
    correlation = loose.statistics[3]
    own.edge_sigma = loose.edges_off * (1.0 - correlation) / (1.0 + correlation)
    rays, at = _places(own)
    for _ in range(COARSE_PASSES):
        if not _misfit_pass(own, rays, at):
            return loose
        if own.moved < SETTLED_PX:
            break
    return own if own.moved < UNSETTLED_PX else loose


def _leaves_less(wide: _FitState, state: _FitState) -> bool:
    spread = min(wide.spread, state.spread)
    return wide.loss(spread) < WIDE_LEFT * state.loss(spread)


def _filtered_or_ideal(state: _FitState) -> _FitState:
    """The fit with a filter where that leaves noise only, as it does of motion; else the ideal one
    to its end.

    Of a webcam's mosaic, gamma and compression a filter leaves more. It makes the residual smaller
    all the same, and bends what a pose is made of: with it poses from rendered markers of 15 to 50
    px were off by up to twice as much.
    """
    filtered = _tried(state, FILTERED) if _filter_pays(state) else None
    _fit_ideal(state, True)
    if filtered is not None and filtered.misfit < min(
        FILTERED_MISFIT, FILTERED_LEFT * state.misfit
    ):
        return filtered
    return state


def _tried(state: _FitState, group: int, wider: float = 1.0) -> _FitState | None:
    """A fit with one group more, from where another one is; None when it leads nowhere.

    ``wider``: times the residual that counts in every pass.
    """
    own = state.copy()
    if group == SHADOWED and not _look_for_shadow(own):
        return None
    own.groups[group] = True
    if group == COARSE:
        own.spread *= max(COARSE_SPREAD, wider)
    else:  # a print needs no filter, which would only bend it
        own.groups[FILTERED] = True
        own.theta[BLUR] = min(max(own.theta[BLUR], LEAST_BLUR_PX), MOST_BLUR_PX)
    much = group != FILTERED or state.misfit > STRONG_MISFIT
    if not own.gather(
        own.theta[BLUR] + FILTER_REACH_PX, MAX_PIXELS if much else MAX_FILTERED, FILTERED_BLOCK
    ):
        return None
    rays, at = _places(own)
    most = MAX_COARSE_PASSES if group == COARSE else MAX_MORE_PASSES if much else MAX_FEW_PASSES
    for attempt in range(most):
        if not _misfit_pass(own, rays, at):
            return None
        own.spread *= wider
        if attempt > 0 and (
            own.moved < SETTLED_PX or (group == SHADOWED and own.extra[-SHADOW] < LEAST_DEPTH)
        ):
            break
    return own if own.moved < UNSETTLED_PX else None


def _look_for_shadow(state: _FitState) -> bool:
    light = cell_light(state.pixels, state.theta, state.frame, state.cells, state.edges)
    beside = find_shadow(light, state.extra[-SHADOW:])
    state.theta[[8, 11]] *= beside
    state.theta[[9, 10, 12, 13, TONE]] = 0.0
    state.spread = 1e3
    state.measured = None
    return beside > 0.0


def _places(state: _FitState) -> tuple[Array, Indices]:
    return (
        stencil(state.pixels, state.frame, state.lens)
        if state.groups[FILTERED]
        else own_places(state.pixels)
    )


def _misfit_pass(state: _FitState, rays: Array, at: Indices) -> bool:
    used, sigmas = used_unknowns(state.groups, state.n, state.edge_sigma)
    normal = np.empty((UNKNOWNS + len(used), UNKNOWNS + len(used) + 1))
    state.residuals = np.empty(len(state.pixels))
    rows = model(
        rays, state.theta, state.extra, state.groups, state.frame, state.cells, state.edges
    )
    taps = state.extra[:TAPS]
    filtered = bool(state.groups[FILTERED])
    accumulate_filtered(
        state.pixels, at, rows, taps, filtered, state.spread, normal, state.residuals
    )
    return _step(state, normal, used, sigmas)


def _step(state: _FitState, normal: Array, used: Places, sigmas: Array) -> bool:
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


def _finished(state: _FitState) -> PhotometricFit:
    covariance = np.empty((8, 8))
    contrast = float(state.theta[11])
    measured = state.statistics
    blur_px = float(state.theta[BLUR])
    finish(
        state.factor, measured, state.lens, state.frame, contrast, blur_px, state.corners, state.jacobian, covariance
    )  # fmt: skip
    _, variance, explained, _ = measured
    wrong = tuple(bool(group) for group in state.groups)
    residual = math.sqrt(variance)
    return PhotometricFit(
        state.corners, covariance, residual, contrast, blur_px, explained, state.passes, wrong
    )
