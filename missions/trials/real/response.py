"""A camera's response, measured on photographs of a board: how it draws an edge, how bright, and
with what noise.

Straight edges of the print are long and their places are known to a tenth of a pixel. So thousands
of pixels beside them show one edge at every fraction of a pixel. A model of the imaging
(``flight.harness.renderer.Imaging``) is fitted to that curve. The corners of markers, which a twin
is made to predict, have no part in it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import least_squares

from flight.harness.renderer import Imaging
from missions.trials.real.board import BoardSeen, Photograph, SetSeen
from missions.trials.real.set import RealSet
from path.arrays import Array
from path.calibration.edges import FLAT_PX, LEAST_PIXELS, PLACES, SeenEdge, mean_edge, see_edge
from path.target.kernels import MAD_TO_SIGMA
from path.values import frozen

FEWEST_EDGES = 12
# of the modelled edge: places of it in a pixel; pixels each way
PHASES = 16
MODEL_REACH_PX = 12
BLUR_REACH = 3.3  # deviations
# from an edge, where compression shows; edges of a photograph that look alike
STEEP_PX = 1.0
FEWEST_ALIKE = 6
SEEN = 0.5  # share of the mean edge that they show
# of JPEG
FINEST = 95
QUALITIES = (5, 99)
STANDARD_FIRST = 16.0  # first entry of JPEG's luminance table at quality 50
TOP = 255.0


@frozen(eq=False)
class BoardEdge:
    """An edge of the board in one photograph. ``middle_o``: (2,) m, of it on the board."""

    middle_o: Array
    seen: SeenEdge


@frozen(eq=False)
class CameraResponse:
    """The response of a camera, by a set of its photographs.

    Attributes:
        imaging: the fitted blur, sharpening, gamma and noise, and the files' compression.
        edge: the mean edge at ``PLACES``, 0 black and 1 white. ``misfit``: rms of what the imaging
            leaves of it.
        noise: standard deviations on black and on white, grey levels. ``edges``: how many were
            seen.
    """

    imaging: Imaging
    edge: Array
    misfit: float
    noise: tuple[float, float]
    edges: int


def edges_of(own: RealSet) -> Iterator[tuple[Array, Array]]:
    """The two ends (2,) on the board, in metres, of every straight edge between black and white."""
    if own.board is None:
        for marker in own.markers.values():
            corners = marker.corners_o[:, :2]
            yield from zip(corners, np.roll(corners, -1, axis=0), strict=True)
        return
    side = own.board.square_m
    for row in range(1, own.board.rows):
        for column in range(own.board.columns):
            yield np.array([column, row]) * side, np.array([column + 1, row]) * side
    for column in range(1, own.board.columns):
        for row in range(own.board.rows):
            yield np.array([column, row]) * side, np.array([column, row + 1]) * side


def see_edges(
    own: RealSet,
    shot: Photograph,
    board: BoardSeen,
) -> list[BoardEdge]:
    """Every edge of the board that a photograph shows well."""
    ends = [np.column_stack([np.stack(pair), np.zeros(2)]) for pair in edges_of(own)]
    pixels = board.pixels(np.concatenate(ends)).reshape(-1, 2, 2) if ends else np.empty((0, 2, 2))
    found = [
        (pair_o[:, :2].mean(axis=0), see_edge(shot.grey, pair_px, board.camera.thinning))
        for pair_px, pair_o in zip(pixels, ends, strict=True)
    ]
    return [BoardEdge(middle_o, edge) for middle_o, edge in found if edge is not None]


def measure_response(
    own: RealSet,
    seen: SetSeen,
    images: Sequence[Path],
) -> CameraResponse | None:
    """The response of a set's camera; None when too few edges are seen.

    Args:
        images: the files, whose compression is taken over.
    """
    pairs = zip(seen.photographs, seen.boards, strict=True)
    edges = [edge.seen for shot, board in pairs for edge in see_edges(own, shot, board)]
    if len(edges) < FEWEST_EDGES:
        return None
    curve, noise, (black, white) = mean_edge(edges), noise_beside(edges), levels_of(edges)
    imaging, misfit = fitted(curve, black, white)
    light = [
        _slope_of_light(level, imaging.gamma) * sd
        for level, sd in zip((black, white), noise, strict=True)
    ]
    imaging = replace(imaging, jpeg_quality=jpeg_quality(images[0]))
    return CameraResponse(
        with_noise(imaging, (black, white), light),
        curve,
        misfit,
        noise,
        len(edges),
    )


def levels_of(edges: Sequence[SeenEdge]) -> tuple[float, float]:
    """Black and white beside edges, medians, grey levels."""
    return float(np.median([edge.black for edge in edges])), float(
        np.median([edge.white for edge in edges])
    )


def noise_beside(edges: Sequence[SeenEdge]) -> tuple[float, float]:
    """Standard deviations of what is left beside edges, on black and on white, after a slope both
    ways.
    """
    left: tuple[list[Array], list[Array]] = ([], [])
    for edge in edges:
        for side, sign in enumerate((-1.0, 1.0)):
            flat = sign * edge.across_px > FLAT_PX
            if np.count_nonzero(flat) >= LEAST_PIXELS:
                x = edge.along[flat] - 0.5
                y = sign * edge.across_px[flat] - FLAT_PX
                design = np.column_stack([np.ones_like(x), x, y, y * y, x * x])
                solution = np.linalg.lstsq(design, edge.levels[flat], rcond=None)[0]
                free = len(x) / (len(x) - design.shape[1])
                left[side].append((edge.levels[flat] - design @ solution) * math.sqrt(free))
    black, white = (
        MAD_TO_SIGMA * float(np.median(np.abs(np.concatenate(some)))) if some else 0.0
        for some in left
    )
    return black, white


def fitted(
    curve: Array,
    black: float,
    white: float,
) -> tuple[Imaging, float]:
    """Blur, sharpening and gamma whose edge is most like the one seen, and the rms of what is
    left.
    """
    there = ~np.isnan(curve)

    def off(x: Array) -> Array:
        return (np.interp(PLACES - x[4], PLACES, edge_of(_optics(x), black, white)) - curve)[there]

    bounds = ([0.3, 0.0, 0.7, 1.0, -0.5], [1.8, 4.0, 2.5, 2.6, 0.5])
    starts = [
        np.array([0.6, sharpen, 1.1, gamma, 0.0]) for sharpen in (0.2, 1.2) for gamma in (1.05, 2.2)
    ]
    found = [least_squares(off, start, bounds=bounds) for start in starts]
    best = found[int(np.argmin([float(one.cost) for one in found]))]
    return _optics(best.x), float(np.sqrt(np.mean(best.fun**2)))


def _optics(x: Array) -> Imaging:
    blur, sharpen, sigma, gamma = (float(value) for value in x[:4])
    return Imaging(blur_sigma_px=blur, gamma=gamma, sharpen=sharpen, sharpen_sigma_px=sigma)


def edge_of(
    imaging: Imaging,
    black: float,
    white: float,
) -> Array:
    """The share of white at the middles of ``PLACES`` that a camera with this imaging draws.

    Pixels are whole ones, in rows that meet the edge at every phase: blur and sharpening are sums
    over pixels.
    """
    whole = np.arange(-MODEL_REACH_PX, MODEL_REACH_PX + 1)
    x = whole[None, :] - (np.arange(PHASES)[:, None] + 0.5) / PHASES
    dark, bright = (TOP * (level / TOP) ** imaging.gamma for level in (max(black, 1.0), white))
    light = dark + (bright - dark) * np.clip(x + 0.5, 0.0, 1.0)
    image = TOP * (np.maximum(_blurred(light, imaging.blur_sigma_px), 0.0) / TOP) ** (
        1.0 / imaging.gamma
    )
    sharp = np.clip(
        image + imaging.sharpen * (image - _blurred(image, imaging.sharpen_sigma_px)),
        0.0,
        TOP,
    )
    order = np.argsort(x, axis=None)
    share = (sharp.ravel()[order] - sharp[0, 0]) / (sharp[0, -1] - sharp[0, 0])
    return np.interp(PLACES, x.ravel()[order], share)


def _blurred(rows: Array, sigma_px: float) -> Array:
    return np.asarray(
        gaussian_filter1d(rows, sigma_px, axis=1, mode="nearest", truncate=BLUR_REACH), np.float64
    )


def _slope_of_light(level: float, gamma: float) -> float:
    """Light per grey level of the image, at a grey level."""
    return gamma * (max(level, 1.0) / TOP) ** (gamma - 1.0)


def scatter_at(photographs: Sequence[Sequence[SeenEdge]]) -> float:
    """Robust deviation of the light at edges from the mean edge of their photograph and direction,
    over the contrast.

    Noise of the sensor is as large beside edges as at them; what compression, a mosaic and uneven
    ink make is at them.
    """
    left: list[Array] = []
    for edges, axis in ((edges, axis) for edges in photographs for axis in (0, 1)):
        alike = [edge for edge in edges if abs(edge.normal[axis]) > abs(edge.normal[1 - axis])]
        if len(alike) < FEWEST_ALIKE:
            continue
        mean = mean_edge(alike)
        there = ~np.isnan(mean)
        if np.mean(there) < SEEN:
            continue
        slope = np.gradient(mean[there], PLACES[there])
        for edge in alike:
            off = (edge.levels - edge.black) / (edge.white - edge.black)
            off -= np.interp(edge.across_px, PLACES[there], mean[there])
            steep = np.interp(edge.across_px, PLACES[there], slope)
            steep /= max(float(np.linalg.norm(steep)), 1e-9)
            left.append((off - steep * float(steep @ off))[np.abs(edge.across_px) < STEEP_PX])
    return MAD_TO_SIGMA * float(np.median(np.abs(np.concatenate(left)))) if left else 0.0


def with_noise(
    imaging: Imaging,
    levels: tuple[float, float],
    sigmas: Sequence[float],
) -> Imaging:
    """The same with noise of the light that has these deviations at two grey levels, black and
    white.
    """
    dark, bright = (TOP * (level / TOP) ** imaging.gamma for level in levels)
    gain = max(0.0, (sigmas[1] ** 2 - sigmas[0] ** 2) / (bright - dark))
    read = math.sqrt(max(0.0, sigmas[0] ** 2 - gain * dark))
    return replace(imaging, read_sigma=read, shot_gain=gain)


def coarser(quality: int | None, times: float) -> int:
    """A JPEG quality with a table of so many times the steps; none is taken for the finest that
    compresses at all.
    """
    of = FINEST if quality is None else quality
    steps = (5000.0 / of if of < 50 else 200.0 - 2.0 * of) * times
    return round(
        float(np.clip(5000.0 / steps if steps > 100.0 else 100.0 - 0.5 * steps, *QUALITIES))
    )


def jpeg_quality(file: Path) -> int | None:
    """The quality, 1..100, whose table of luminance a JPEG file has; None for other files."""
    content = file.read_bytes()
    table = content.find(b"\xff\xdb")
    if not content.startswith(b"\xff\xd8") or table < 0:
        return None
    first = max(1, content[table + 5])
    scale = 100.0 * first / STANDARD_FIRST
    return round(np.clip(100.0 - scale / 2.0 if scale <= 100.0 else 5000.0 / scale, 1.0, 100.0))
