"""Corners of a marker from a fit of its whole image, not of its edges.

Gauss-Newton with robust weights on the model of ``pattern``, an ideal print and camera. Where that
leaves more than noise, it is asked what is wrong, see ``misfit``. The normal matrix, the size of
the residual and how far it is correlated from pixel to pixel give the covariance of the corners:
what the model cannot explain is correlated, and counts for fewer pixels than it has.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from path.camera.model import CameraModel
from path.marker.kernels import Array
from path.marker.photometric.kernels import finish
from path.marker.photometric.known import AGAIN, LEVEL_GAIN, QUESTIONS, Known
from path.marker.photometric.misfit import (
    COARSE,
    FILTERED,
    GROUPS,
    SHADOW,
    SHADOWED,
    TAPS,
    accumulate_filtered,
    model,
    own_places,
)
from path.marker.photometric.passes import (
    FIRST_PIXELS,
    SETTLED_PX,
    FitState,
    explained,
    fit_ideal,
    misfit_pass,
    misfits,
    places,
    start,
)
from path.marker.photometric.pattern import BLUR, TONE, UNKNOWNS
from path.marker.photometric.print_pixels import MAX_PIXELS, Gray
from path.marker.photometric.shadow import cell_light, find_shadow

# with what may be wrong: a shadow or much, or little
MAX_MORE_PASSES = 6
MAX_FEW_PASSES = 2
MAX_COARSE_PASSES = 8  # with inner edges that may be off far
# residual over contrast that is worth all pixels and passes
STRONG_MISFIT = 0.055
STRONG_CORRELATED_MISFIT = 0.035
# side from which on less than that is not worth it: a pose is as good as print and lens are known
LARGE_PX = 42.0
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
# of a fit that begins with what is known of the print: a shorter step is followed by none that matters
KNOWN_SETTLED_PX = 0.08
LEARN_OF = 2  # of so many pixels one tells of inner edges: they last, and frames are many
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
    known: Known | None = None,
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
        known: what earlier frames told of this marker, to start from and to be bettered: instead of
            everything that may be wrong, what is known is tried, and at most one thing else.

    Returns:
        None when the fit does not converge or too few pixels show the print.
    """
    state = start(
        image, offset, start_px, camera, cells, edges, FIRST_PIXELS if near else MAX_PIXELS, border
    )
    if state is None:
        return None
    if known is not None and known.frames > 0:
        usual = known.left
        fitted = _fit_known(state, known, near)
        if known.own or (fitted is not None and fitted.misfit < AGAIN * usual):
            known.own = True
            return None if fitted is None else _finished(fitted)
        # another kind of print than those that this camera has seen
        known.own = True
        known.forget()
        return fit(
            image, offset, start_px, camera, cells, edges, near=near, border=border, known=known
        )
    if not fit_ideal(state, ideal, near):
        return None
    if not ideal and misfits(state):
        state = (_settled(state) if near and explained(state) else None) or _fit_misfit(state)
    if state.moved > UNSETTLED_PX:
        return None
    if known is not None:
        _begin(state, known)
    return _finished(state)


def _begin(state: FitState, known: Known) -> None:
    """Take what a fit that asked everything has found as known."""
    _note(state, known)
    known.left = state.misfit
    if state.groups[COARSE]:
        known.offsets = state.extra[TAPS:-SHADOW].copy()
        state.edges = known.moved(state.edges)
        _learn(state, known)
    for question, group in enumerate(QUESTIONS):
        if state.groups[group] and not state.groups[COARSE]:
            known.question = question
            known.extra = state.extra.copy()


def _fit_known(state: FitState, known: Known, near: bool) -> FitState | None:
    """The fit that starts from what earlier frames told; None when it does not converge."""
    state.edges = known.moved(state.edges)
    state.theta[BLUR] = known.blur_px
    state.theta[TONE] = known.tone
    if not fit_ideal(state, True, near, KNOWN_SETTLED_PX) or state.moved > UNSETTLED_PX:
        known.forget()
        return None
    _note(state, known)
    if not misfits(state):
        return state
    better = _asked(state, known)
    if better is None and known.learns:
        _learn(state, known)
    return better or state


def _note(state: FitState, known: Known) -> None:
    known.frames += 1
    known.blur_px = float(state.theta[BLUR])
    known.tone = float(state.theta[TONE])


def _asked(state: FitState, known: Known) -> FitState | None:
    """The fit that one term more explains: the one that did in the frame before, else one a frame,
    and none while as much is left as when all were asked in vain. What none explains may be another
    print.
    """
    if known.extra is None and state.misfit < AGAIN * known.left:
        known.left += LEVEL_GAIN * (state.misfit - known.left)
        return None
    group = QUESTIONS[known.question]
    wanted = state.correlated_misfit > SHADOW_MISFIT if group == SHADOWED else _filter_pays(state)
    tried = _tried(state, group, begun=known.extra) if wanted else None
    if tried is not None and _pays(tried, state, group):
        known.extra = tried.extra.copy()
        return tried
    known.extra = None
    known.question = (known.question + 1) % len(QUESTIONS)
    if known.question == 0:
        known.left = state.misfit
        known.learn_anew()
    return None


def _pays(tried: FitState, state: FitState, group: int) -> bool:
    """Return whether a fit with a filter or a shadow explains what is left without."""
    if group == SHADOWED:
        return tried.misfit <= SHADOW_LEFT * state.misfit and tried.noise <= state.noise
    return tried.misfit < min(FILTERED_MISFIT, FILTERED_LEFT * state.misfit)


def _learn(state: FitState, known: Known) -> None:
    """Better what is known of a print's inner edges by one pass at the end of a fit."""
    if not _tells_edges(state):
        return
    groups = np.zeros(GROUPS, np.bool_)
    groups[COARSE] = True
    pixels = np.ascontiguousarray(state.pixels[::LEARN_OF])
    rays, at = own_places(pixels)
    size = UNKNOWNS + len(known.offsets)
    normal = np.empty((size, size + 1))
    residuals = np.empty(len(pixels))
    extra = np.zeros(len(state.extra))
    rows = model(rays, state.theta, extra, groups, state.frame, state.cells, state.edges)
    accumulate_filtered(
        pixels, at, rows, extra[:TAPS], False, COARSE_SPREAD * state.spread, normal, residuals
    )
    _, variance, _, correlation = state.statistics
    known.learn(normal, UNKNOWNS, variance * ((1.0 + correlation) / (1.0 - correlation)) ** 2)


def _settled(state: FitState) -> FitState | None:
    """A fit that began near after one pass more; None when that does not explain the image either.

    Residuals are those before the last step, which was the first with all pixels: they may be of
    that step alone.
    """
    own = state.copy()
    return own if fit_ideal(own, True) and not misfits(own) else None


def _filter_pays(state: FitState) -> bool:
    """Return whether a filter betters a pose: of a large marker only where much is wrong."""
    much = state.misfit > STRONG_MISFIT or state.correlated_misfit > STRONG_CORRELATED_MISFIT
    return much or state.area_px2 < LARGE_PX**2


def _fit_misfit(state: FitState) -> FitState:
    """The fit that knows what may be wrong, where that explains more than the ideal one; else that
    one, to its end.
    """
    better: FitState | None = None
    if state.correlated_misfit > SHADOW_MISFIT:
        better = _tried(state, SHADOWED)
    if better is None or not _pays(better, state, SHADOWED):
        better = _filtered_or_ideal(state)
    return _of_coarse_print(better) or better


def _of_coarse_print(state: FitState) -> FitState | None:
    """The fit whose inner edges are free, None where they are not off by more than noise makes
    them.

    They are found first, whatever they are; how far they are off together is what is then expected
    of each, the less the more the residual is correlated: as many pixels as it seems do not tell an
    edge.
    """
    least = max(LEAST_OFF, LEAST_OFF_PX / _cell_px(state))
    loose = _tried(state, COARSE, WIDE_SPREAD) if _tells_edges(state) else None
    if loose is not None and loose.edges_off > least and not _leaves_less(loose, state):
        # what lies across a print moves edges too, and leaves as much as before
        loose = _tried(state, COARSE)
    if loose is None or loose.edges_off < least:
        return None
    own = loose.copy()
    correlation = loose.statistics[3]
    own.edge_sigma = loose.edges_off * (1.0 - correlation) / (1.0 + correlation)
    rays, at = places(own)
    for _ in range(COARSE_PASSES):
        if not misfit_pass(own, rays, at):
            return loose
        if own.moved < SETTLED_PX:
            break
    return own if own.moved < UNSETTLED_PX else loose


def _cell_px(state: FitState) -> float:
    return math.sqrt(state.area_px2) / state.n


def _tells_edges(state: FitState) -> bool:
    return _cell_px(state) > LEAST_CELL_PX


def _leaves_less(wide: FitState, state: FitState) -> bool:
    spread = min(wide.spread, state.spread)
    return wide.loss(spread) < WIDE_LEFT * state.loss(spread)


def _filtered_or_ideal(state: FitState) -> FitState:
    """The fit with a filter where that leaves noise only, as it does of motion; else the ideal one
    to its end.

    Of a webcam's mosaic, gamma and compression a filter leaves more. It makes the residual smaller
    all the same, and bends what a pose is made of: with it poses from rendered markers of 15 to 50
    px were off by up to twice as much.
    """
    filtered = _tried(state, FILTERED) if _filter_pays(state) else None
    fit_ideal(state, True)
    return filtered if filtered is not None and _pays(filtered, state, FILTERED) else state


def _tried(
    state: FitState, group: int, wider: float = 1.0, begun: Array | None = None
) -> FitState | None:
    """A fit with one group more, from where another one is; None when it leads nowhere.

    ``wider``: times the residual that counts in every pass. ``begun``: values of the group from the
    frame before.
    """
    own = state.copy()
    if begun is not None:
        own.extra = begun.copy()
    elif group == SHADOWED and not _look_for_shadow(own):
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
    rays, at = places(own)
    most = MAX_COARSE_PASSES if group == COARSE else MAX_MORE_PASSES if much else MAX_FEW_PASSES
    for attempt in range(most):
        if not misfit_pass(own, rays, at):
            return None
        own.spread *= wider
        if attempt > 0 and (
            own.moved < SETTLED_PX or (group == SHADOWED and own.extra[-SHADOW] < LEAST_DEPTH)
        ):
            break
    return own if own.moved < UNSETTLED_PX else None


def _look_for_shadow(state: FitState) -> bool:
    light = cell_light(state.pixels, state.theta, state.frame, state.cells, state.edges)
    beside = find_shadow(light, state.extra[-SHADOW:])
    state.theta[[8, 11]] *= beside
    state.theta[[9, 10, 12, 13, TONE]] = 0.0
    state.spread = 1e3
    state.measured = None
    return beside > 0.0


def _finished(state: FitState) -> PhotometricFit:
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
