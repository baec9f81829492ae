"""A set's print as its photographs show it: where its ink lies on the board, so that a twin can be
drawn alike.

Three things move it: what all views agree on of the squares' corners and of the markers' corners
and cells, which is the print's, and in each view what lens, motion and paper do beyond a flat
board's pose (``BoardSeen.bend``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np

from missions.trials.real.board import BoardSeen, SetSeen, robust_solution
from missions.trials.real.cells import inner_edges
from missions.trials.real.errors import FEWEST_VIEWS, MethodPoses, printed
from missions.trials.real.set import RealSet
from path.arrays import Array, Image, Singles
from path.values import frozen

CELL_PX = 0.3  # of the photographs: how finely ink is moved
MOST_CELLS = 2600  # of a print, across
NODES = 25  # each way, between which what moves the ink is smooth


@frozen(eq=False)
class Print:
    """A flat print of square cells: shades, the side of a cell in metres, the place of its corner
    on the board.
    """

    shades: Image
    cell_m: float
    corner_o: Array

    def finer(self, cell_m: float) -> Print:
        """The same with cells of at most this side, where that is not too many."""
        times = min(math.ceil(self.cell_m / cell_m), MOST_CELLS // max(self.shades.shape))
        if times <= 1:
            return self
        return Print(
            np.kron(self.shades, np.ones((times, times), np.uint8)),
            self.cell_m / times,
            self.corner_o,
        )


@frozen(eq=False)
class InkMoves:
    """By how much ink lies elsewhere than it was meant to.

    Attributes:
        squares: places (n, 2) of the squares' corners on the board, and by how much they are off,
            metres.
        markers: of each marker its corners as meant (4, 2) and by how much they are off (4, 2),
            metres.
        inner: of each marker (2, n - 1), by how much the lines between its columns and its rows are
            off, in cells.
    """

    squares: tuple[Array, Array]
    markers: tuple[tuple[Array, Array], ...]
    inner: tuple[Array, ...] = ()


def ink_moves(
    own: RealSet,
    seen: SetSeen,
    measured: MethodPoses | None,
) -> InkMoves:
    """The moves that all views agree on, of squares, of markers and of the edges inside them."""
    markers = () if measured is None else tuple(
        (
            own.markers[i].corners_o[:, :2],
            (printed(own, measured.growth, i) - own.markers[i].corners_o)[:, :2] + off[:, :2],
        )
        for i, off in sorted(measured.print_m.items())
    )  # fmt: skip
    errors: dict[tuple[float, float], list[tuple[Array, Array]]] = {}
    for shot, board in zip(
        seen.photographs if own.board is not None else (),
        seen.boards,
        strict=False,
    ):
        left = shot.corners_px - board.pixels(shot.points_o)
        slopes = board.slopes(shot.points_o)
        for point, error, slope in zip(shot.points_o, left, slopes, strict=True):
            errors.setdefault((float(point[0]), float(point[1])), []).append((error, slope))
    told = {place: some for place, some in errors.items() if len(some) >= FEWEST_VIEWS}
    off = [
        robust_solution(
            np.concatenate([slope for _, slope in some]),
            np.concatenate([error for error, _ in some]),
        )
        for some in told.values()
    ]
    inner = {} if measured is None else inner_edges(own, seen, measured)
    squares = np.array(list(told)).reshape(-1, 2), np.array(off).reshape(-1, 2)
    return InkMoves(squares, markers, tuple(inner[i] for i in sorted(inner)))


def as_seen(
    flat: Print,
    moves: InkMoves,
    board: BoardSeen,
) -> Print:
    """The print as one photograph shows it, drawn on a flat board at ``T_c_o``."""
    rows, columns = flat.shades.shape
    x = flat.corner_o[0] + (np.arange(columns) + 0.5) * flat.cell_m
    y = flat.corner_o[1] + (np.arange(rows) + 0.5) * flat.cell_m
    moved = _of_squares(moves.squares, x, y) + np.zeros((rows, columns, 2))
    for k, (corners, off) in enumerate(moves.markers):
        _move_marker(moved, corners, off, x, y)
        if moves.inner:
            _move_inside(moved, corners, moves.inner[k], x, y)
    moved += _bent(board, x, y)
    place = (np.stack(np.meshgrid(x, y), axis=-1) - moved - flat.corner_o) / flat.cell_m - 0.5
    u, v = (np.ascontiguousarray(place[..., axis], np.float32) for axis in (0, 1))
    shades = cv2.remap(flat.shades, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return Print(np.asarray(shades, np.uint8), flat.cell_m, flat.corner_o)


def _of_squares(
    squares: tuple[Array, Array],
    x: Array,
    y: Array,
) -> Array:
    """By how much the squares are off, (rows, columns, 2): linear between their corners."""
    places, off = squares
    moved = np.zeros((len(y), len(x), 2))
    columns, rows = (np.unique(np.round(places[:, axis], 9)) for axis in (0, 1))
    if min(len(columns), len(rows)) < 2 or len(places) < len(columns) * len(rows):
        return moved
    order = np.lexsort((places[:, 0], places[:, 1]))
    table = off[order].reshape(len(rows), len(columns), 2)
    u, v = np.meshgrid(_between(x, columns), _between(y, rows))
    for axis in (0, 1):
        moved[..., axis] = cv2.remap(
            np.ascontiguousarray(table[..., axis], np.float32),
            u,
            v,
            cv2.INTER_LINEAR,
        )
    return moved


def _between(places: Array, nodes: Array) -> Singles:
    return np.interp(places, nodes, np.arange(len(nodes))).astype(np.float32)


def _move_marker(
    moved: Array,
    corners: Array,
    off: Array,
    x: Array,
    y: Array,
) -> None:
    """A marker lies where its four corners do, and takes along half of the white about it."""
    low = corners.min(axis=0)
    high = corners.max(axis=0)
    rim = 0.08 * (high - low)
    across, down = (
        slice(*np.searchsorted(places, (low[axis] - rim[axis], high[axis] + rim[axis])))
        for axis, places in enumerate((x, y))
    )
    s, t = np.meshgrid(
        (x[across] - low[0]) / (high[0] - low[0]), (y[down] - low[1]) / (high[1] - low[1])
    )
    share = (corners - low) / (high - low)
    moved[down, across] = sum(
        (np.where(a > 0.5, s, 1.0 - s) * np.where(b > 0.5, t, 1.0 - t))[..., None] * own
        for (a, b), own in zip(share, off, strict=True)
    )


def _move_inside(
    moved: Array,
    corners: Array,
    inner: Array,
    x: Array,
    y: Array,
) -> None:
    """Lines between cells are where they are seen; ink between them is stretched."""
    low = corners.min(axis=0)
    high = corners.max(axis=0)
    n = inner.shape[1] + 1
    cell_m = (high - low) / n
    inside = [
        slice(*np.searchsorted(places, (low[axis], high[axis])))
        for axis, places in enumerate((x, y))
    ]
    along = [
        np.interp((places[some] - low[axis]) / cell_m[axis], np.arange(n + 1) + ends, ends)
        * cell_m[axis]
        for axis, (places, some, ends) in enumerate(
            zip((x, y), inside, np.pad(inner, ((0, 0), (1, 1))), strict=True)
        )
    ]
    moved[inside[1], inside[0], 0] += along[0][None, :]
    moved[inside[1], inside[0], 1] += along[1][:, None]


def _bent(
    board: BoardSeen,
    x: Array,
    y: Array,
) -> Array:
    """By how much ink on a flat board would have to lie elsewhere to be seen where it is, (rows,
    columns, 2).
    """
    nodes = np.stack(
        np.meshgrid(np.linspace(x[0], x[-1], NODES), np.linspace(y[0], y[-1], NODES)), axis=-1
    )
    points = np.column_stack([nodes.reshape(-1, 2), np.zeros(NODES**2)])
    off_px = board.pixels(points) - board.camera.project(board.T_c_o.apply(points))
    off = np.linalg.solve(board.slopes(points), off_px[..., None])[..., 0].reshape(NODES, NODES, 2)
    u, v = np.meshgrid(
        np.linspace(0.0, NODES - 1.0, len(x), dtype=np.float32),
        np.linspace(0.0, NODES - 1.0, len(y), dtype=np.float32),
    )
    parts = [
        cv2.remap(off[..., axis].astype(np.float32), u, v, cv2.INTER_LINEAR) for axis in (0, 1)
    ]
    return np.stack(parts, axis=-1).astype(np.float64)


def pixel_m(seen: SetSeen) -> float:
    """The side of a pixel on the board, where photographs show it largest."""
    pairs: Sequence[tuple[Array, BoardSeen]] = [
        (shot.points_o, board) for shot, board in zip(seen.photographs, seen.boards, strict=True)
    ]
    return 1.0 / max(
        float(np.median(np.linalg.norm(board.slopes(points), axis=1))) for points, board in pairs
    )
