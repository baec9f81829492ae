"""The edges between a marker's cells, as all photographs show them: a picture of few pixels has
them off.

Light is read across each of them in every view, and where it changes is where the edge is. No
marker's fit has a part in that. White cells look larger than they are, or smaller, as camera and
compression will have it: what edges from black to white and from white to black are off by against
each other, over the whole set, is taken off.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import cv2
import numpy as np

from missions.trials.real.board import BoardSeen, Photograph, SetSeen
from missions.trials.real.errors import MethodPoses, printed
from missions.trials.real.set import RealSet
from missions.trials.shared.statistics import robust_sigma
from path.arrays import Array, Flags, Whole
from path.values import frozen

ACROSS = np.linspace(-0.5, 0.5, 13)  # in cells, of an edge: where light is read
ALONG = np.linspace(-0.3, 0.3, 5)
LEAST_CHANGE = 15.0  # grey levels over an edge that is seen
PASSES = 3  # each reads about where edges were found before
MEDIANS = 1.25  # standard error of a median, over that of a mean
FEWEST_READ = 3  # of an edge, for each direction of the change


@frozen(eq=False)
class CellEdges:
    """The edges between cells of one marker.

    Attributes:
        n: cells in a row. ``middles``: (k, 2) in cells from the marker's first corner.
        axis: (k,) 0 for those across x, 1 across y. ``lines``: (k,) which of the 2 (n - 1) inner
            lines, across x first.
        rising: (k,) white comes after black.
    """

    n: int
    middles: Array
    axis: Whole
    lines: Whole
    rising: Flags

    def places(self, off: Array) -> Array:
        """Places (k, along, across, 2) of what is read, in shares of the marker, with lines off by
        so many cells.
        """
        along, across = np.meshgrid(ALONG, ACROSS, indexing="ij")
        reach = np.stack([np.stack((across, along), axis=-1), np.stack((along, across), axis=-1)])[
            self.axis
        ]
        moved = self.middles.copy()
        moved[np.arange(len(moved)), self.axis] += off[self.lines]
        return np.asarray((moved[:, None, None, :] + reach) / self.n, np.float64)


def inner_edges(
    own: RealSet,
    seen: SetSeen,
    measured: MethodPoses,
) -> dict[int, Array]:
    """By marker (2, n - 1): by how much the lines between its columns, and its rows, are off, in
    cells.

    All are taken to be off by less where much of what is found may be the noise of what was read.
    """
    if not measured.print_m:
        return {}
    edges = {i: _edges_of(own.markers[i].pattern[1:-1, 1:-1] > 0.5) for i in measured.print_m}
    corners = {
        i: printed(own, measured.growth, i)[:, :2] + off[:, :2]
        for i, off in measured.print_m.items()
    }
    lines = {i: 2 * (len(own.markers[i].pattern) - 3) for i in edges}
    off = {i: np.zeros(count) for i, count in lines.items()}
    doubt = dict(off)
    for _ in range(PASSES):
        read = {i: _read_all(one, _on_board(one.places(off[i]), corners[i]), seen, _views(measured, i))
                for i, one in edges.items()}  # fmt: skip
        wider = _wider(edges, read)
        for i, one in edges.items():
            more, doubt[i] = _agreed(
                one,
                read[i] - wider * np.where(one.rising, 1.0, -1.0),
                lines[i],
            )
            off[i] = off[i] + more
    size, noise = (sum(float(np.sum(some**2)) for some in those.values()) for those in (off, doubt))
    share = max(0.0, 1.0 - noise / size) if size > 0.0 else 0.0
    return {i: share * one.reshape(2, -1) for i, one in off.items()}


def _edges_of(cells: Flags) -> CellEdges:
    n = len(cells)
    found = [
        (axis, line, k, bool(those[k, line]))
        for axis, those in enumerate((cells, cells.T))
        for line in range(1, n)
        for k in np.flatnonzero(those[:, line - 1] != those[:, line]).tolist()
    ]
    axes, lines, rows = (np.array([edge[part] for edge in found], np.int64) for part in range(3))
    middles = np.where(
        axes[:, None] == 0,
        np.column_stack([lines, rows + 0.5]),
        np.column_stack([rows + 0.5, lines]),
    )
    return CellEdges(
        n,
        middles,
        axes,
        axes * (n - 1) + lines - 1,
        np.array([edge[3] for edge in found]),
    )


def _on_board(share: Array, corners: Array) -> Array:
    s = share[..., :1]
    t = share[..., 1:]
    flat = (
        (1 - s) * (1 - t) * corners[0]
        + s * (1 - t) * corners[1]
        + s * t * corners[2]
        + (1 - s) * t * corners[3]
    )
    return np.concatenate([flat, np.zeros_like(s)], axis=-1)


def _views(measured: MethodPoses, marker_id: int) -> list[int]:
    return sorted({marker.view for marker in measured.seen if marker.marker_id == marker_id})


def _read_all(
    edges: CellEdges,
    points_o: Array,
    seen: SetSeen,
    views: Sequence[int],
) -> Array:
    return np.stack(
        [_read(edges.rising, points_o, seen.photographs[view], seen.boards[view]) for view in views]
    )


def _wider(edges: Mapping[int, CellEdges], read: Mapping[int, Array]) -> float:
    """By how much black ends later than it should, at all edges alike: white looks smaller."""
    sides = [
        np.concatenate([read[i][:, one.rising == way].ravel() for i, one in edges.items()])
        for way in (True, False)
    ]
    rising, falling = (
        float(np.nanmedian(side)) if np.isfinite(side).any() else 0.0 for side in sides
    )
    return 0.5 * (rising - falling)


def _read(
    rising: Flags,
    points_o: Array,
    shot: Photograph,
    board: BoardSeen,
) -> Array:
    """By how far from its place (k, along, across, 3) each edge is in one view, in cells; nan where
    it is not seen.
    """
    pixels = board.pixels(points_o.reshape(-1, 3))
    thinning = board.camera.thinning
    if thinning is not None:
        for axis, size in enumerate(shot.grey.shape[::-1]):
            pixels[:, axis] = np.interp(
                pixels[:, axis],
                thinning.places(np.arange(size), axis),
                np.arange(size),
            )
    u, v = (np.ascontiguousarray(pixels[:, axis].reshape(1, -1), np.float32) for axis in (0, 1))
    light = cv2.remap(
        shot.grey.astype(np.float32),
        u,
        v,
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
    profile = np.asarray(light, np.float64).reshape(points_o.shape[:3]).mean(axis=1)
    change = np.diff(np.where(rising, 1.0, -1.0)[:, None] * profile, axis=1).clip(0.0, None)
    whole = change.sum(axis=1)
    middles = 0.5 * (ACROSS[1:] + ACROSS[:-1])
    return np.where(whole > LEAST_CHANGE, change @ middles / np.maximum(whole, 1e-9), np.nan)


def _agreed(
    edges: CellEdges,
    read: Array,
    lines: int,
) -> tuple[Array, Array]:
    """By how much each line is off, and the standard error of that; 0 of both where it is not
    seen.
    """
    off = np.zeros(lines)
    doubt = np.zeros(lines)
    for line in range(lines):
        sides = [
            read[:, (edges.lines == line) & (edges.rising == way)].ravel() for way in (True, False)
        ]
        there = [side[~np.isnan(side)] for side in sides]
        told = [side for side in there if len(side) >= FEWEST_READ]
        if told:
            middles = [float(np.median(side)) for side in told]
            errors = [
                robust_sigma(side - middle) / len(side) ** 0.5
                for side, middle in zip(told, middles, strict=True)
            ]
            off[line] = float(np.mean(middles))
            doubt[line] = MEDIANS * float(np.linalg.norm(errors)) / len(told)
    return off, doubt
