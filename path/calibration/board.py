"""Flat calibration boards, chessboard and ChArUco: their corners, their print, and how they are
found in an image.

Frame ``o`` of a board: origin at the top-left corner of the top-left square as printed, x right, y
down, z away from who reads it. Squares are counted, not inner corners, for both patterns.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Literal

import cv2
import numpy as np

from path.arrays import Array, Flags, Image, Whole
from path.calibration.saddles import REACH_PX, refine_saddles
from path.camera.thinning import Thinning
from path.marker.layout import DICTIONARIES
from path.marker.photometric.texture import dictionary_of
from path.values import frozen

Pattern = Literal["charuco", "chessboard"]

FINEST_SQUARE = 64  # cells that a square of a print may be divided into
CLEAR = 0.85  # share of the distance to the next thing printed that the fit of a corner may look at
FEWEST_CORNERS = 6  # on a board below it there is nothing to find
LEAST_SADDLES = 0.3  # share of the corners of a line that are saddles, where it is of the print


@frozen
class Board:
    """A printed board.

    Attributes:
        pattern: "charuco" or "chessboard".
        columns, rows: squares along x and y.
        square_m: side of a square, as measured on the print.
        marker_m: side of the black frame of a ChArUco board's markers.
        dictionary: of these markers.
        legacy: a ChArUco board as OpenCV drew it before version 4.6: with an even number of rows
            the top-left square is a white one, with a marker in it.

    Raises:
        ValueError: naming the field that cannot be right.
    """

    pattern: Pattern
    columns: int
    rows: int
    square_m: float
    marker_m: float = 0.0
    dictionary: str = "DICT_4X4_50"
    legacy: bool = False

    def __post_init__(self) -> None:
        if (
            min(self.columns, self.rows) < 3
            or (self.columns - 1) * (self.rows - 1) < FEWEST_CORNERS
        ):
            raise ValueError(
                f"squares: {self.columns}x{self.rows} has fewer than {FEWEST_CORNERS} inner corners"
            )
        if not 0.0 < self.square_m < 10.0:
            raise ValueError(f"square_m: {self.square_m!r} is not a length in metres")
        if self.pattern == "chessboard":
            return
        if not 0.3 * self.square_m <= self.marker_m <= 0.95 * self.square_m:
            raise ValueError(
                f"marker_m: {self.marker_m!r} is not 0.3 to 0.95 of square_m = {self.square_m!r}"
            )
        if self.dictionary not in DICTIONARIES:
            raise ValueError(
                f"dictionary: {self.dictionary!r} is none of {', '.join(DICTIONARIES)}"
            )
        if self.columns * self.rows // 2 > DICTIONARIES[self.dictionary][1]:
            raise ValueError(
                f"dictionary: {self.dictionary} has too few markers for {self.columns}x{self.rows}"
            )

    @property
    def corners_o(self) -> Array:
        """Inner corners, shape (n, 3), metres, row by row."""
        x, y = np.meshgrid(np.arange(1, self.columns), np.arange(1, self.rows))
        return (
            np.stack((x.ravel(), y.ravel(), np.zeros(x.size)), axis=1).astype(np.float64)
            * self.square_m
        )

    @property
    def markers_o(self) -> dict[int, Array]:
        """Corners of a ChArUco board's markers by id, shape (4, 3), metres, in the order of the
        print.
        """
        if self.pattern == "chessboard":
            return {}
        charuco = _charuco_board(self)
        corners = (
            np.asarray(points, np.float64).reshape(4, 3) for points in charuco.getObjPoints()
        )
        return dict(zip((int(i) for i in np.ravel(charuco.getIds())), corners, strict=True))

    @property
    def text(self) -> str:
        """Return the board's name in messages."""
        size = f"{self.columns}x{self.rows} squares of {1000.0 * self.square_m:g} mm"
        if self.pattern == "chessboard":
            return f"chessboard, {size}"
        return f"ChArUco, {size}, {self.dictionary}{', old pattern' if self.legacy else ''}"


@frozen(eq=False)
class BoardView:
    """A board found in one image.

    Attributes:
        ids: (n,) indices into ``Board.corners_o``.
        corners_px: (n, 2). ``sigma_px``: (n,) standard deviation per axis by the image's noise.
        blur_px: standard deviation of the blur across the edges, the larger one of the two
            directions, median.
    """

    ids: Whole
    corners_px: Array
    sigma_px: Array
    blur_px: float


@frozen(eq=False)
class FoundCorners:
    """Corners as OpenCV finds them, before refinement.

    ``clear_px``: (n,) how far around a corner only its four squares are.
    """

    ids: Whole
    corners_px: Array
    clear_px: Array


def find_board(grey: Image, board: Board, thinning: Thinning | None = None) -> BoardView | None:
    """Find a board and refine its corners (``path.calibration.saddles``); None when it is not
    there.

    Args:
        grey: uint8 (h, w), as the lens gives it. Of a ChArUco board any part is enough, of a
            chessboard the whole.
        thinning: how the camera leaves out pixels; corners come out in its evenly spaced image.
    """
    found = find_corners(grey, board)
    if found is None:
        return None
    edges = _edge_directions(found, board)
    if edges is None:
        return None
    saddles = refine_saddles(grey, found.corners_px, edges, found.clear_px, thinning)
    good = saddles.good
    if int(good.sum()) < FEWEST_CORNERS or (
        board.pattern == "chessboard" and not _all_print(grey, found, good, board)
    ):
        return None
    return BoardView(
        found.ids[good],
        saddles.corners_px[good],
        saddles.sigma_px[good],
        float(np.median(saddles.blur_px[good])),
    )


def find_corners(grey: Image, board: Board) -> FoundCorners | None:
    """The corners as OpenCV gives them."""
    if board.pattern == "chessboard":
        size = (board.columns - 1, board.rows - 1)
        found, corners = cv2.findChessboardCornersSB(
            grey, size, flags=cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
        )
        # the older method sees boards in bad light or cut close at the border, and coarser
        if not found:
            flags = (
                cv2.CALIB_CB_ADAPTIVE_THRESH
                | cv2.CALIB_CB_NORMALIZE_IMAGE
                | cv2.CALIB_CB_FAST_CHECK
            )
            found, corners = cv2.findChessboardCorners(grey, size, flags=flags)
        ids = np.arange((board.columns - 1) * (board.rows - 1))
        if not found:
            return None
    else:
        corners, ids, _, _ = _charuco_detector(board).detectBoard(grey)
        if ids is None or corners is None:  # pyright: ignore[reportUnnecessaryComparison]
            return None
    ids = np.asarray(ids, np.int64).ravel()
    points = np.asarray(corners, np.float64).reshape(-1, 2)
    if len(ids) < FEWEST_CORNERS or not _spans_a_plane(ids, board):
        return None
    share = 0.5
    # the nearest other thing is a corner of a marker, along the diagonal
    if board.pattern == "charuco":
        share = min(share, np.sqrt(0.5) * (1.0 - board.marker_m / board.square_m))
    return FoundCorners(ids, points, CLEAR * share * _pitch_px(points, ids, board))


def other_size(grey: Image) -> tuple[int, int] | None:
    """Return about how many columns and rows of squares a chessboard in an image has; None when
    there is none.

    OpenCV grows the grid beyond the print, where a dark square's outer corner lies where an inner
    one would. Only inner corners are saddles: outermost lines that have few of them are taken off
    again.
    """
    flags = cv2.CALIB_CB_LARGER | cv2.CALIB_CB_EXHAUSTIVE
    found, corners, meta = cv2.findChessboardCornersSBWithMeta(grey, (3, 3), flags)
    if not found:
        return None
    grid = np.asarray(corners, np.float64).reshape(*meta.shape[:2], 2)
    if min(grid.shape[:2]) < 2:
        return None  # a row of corners is no board
    points = grid.reshape(-1, 2)
    ways = np.stack((np.gradient(grid, axis=1), np.gradient(grid, axis=0)), axis=2).reshape(
        -1, 2, 2
    )
    steps = np.linalg.norm(ways, axis=2)
    sound = np.isfinite(steps).all(axis=1) & (steps > 1.0).all(axis=1)
    sound[sound] &= (
        (points[sound] >= 0.0) & (points[sound] <= np.array(grey.shape[::-1]) - 1.0)
    ).all(axis=1)
    edges = ways[sound] / steps[sound][:, :, None]
    clear_px = CLEAR * 0.5 * steps[sound].min(axis=1)
    sound[sound] &= refine_saddles(grey, points[sound], edges, clear_px).good
    rows, columns = _within_print(sound.reshape(grid.shape[:2])).shape
    return columns + 1, rows + 1


def _all_print(grey: Image, found: FoundCorners, good: Flags, board: Board) -> bool:
    """Whether every outermost line of a chessboard is of the print. Near the image's border nothing
    can be told.
    """
    inside = np.array(grey.shape[::-1]) - 1.0 - REACH_PX[1]
    near = ((found.corners_px < REACH_PX[1]) | (found.corners_px > inside)).any(axis=1)
    grid = (good | near).reshape(board.rows - 1, board.columns - 1)
    return _within_print(grid).shape == grid.shape


def _within_print(good: Flags) -> Flags:
    """The part of a grid of corners that is left when outermost lines of which few are good are
    taken off.
    """
    while min(good.shape) > 2:
        sides = [
            (good[0], good[1:]),
            (good[-1], good[:-1]),
            (good[:, 0], good[:, 1:]),
            (good[:, -1], good[:, :-1]),
        ]
        line, rest = min(sides, key=lambda side: float(side[0].mean()))
        if line.mean() >= LEAST_SADDLES:
            break
        good = rest
    return good


def print_cells(board: Board) -> tuple[Image, float]:
    """The print with a white border of one square: shades (rows, columns), and the side of one cell
    in metres.

    The board's origin is one square right of and below the print's corner.

    Raises:
        ValueError: the markers do not divide the squares into at most ``FINEST_SQUARE`` cells.
    """
    if board.pattern == "chessboard":
        squares = np.indices((board.rows, board.columns)).sum(axis=0) % 2
        return np.pad((255 * squares).astype(np.uint8), 1, constant_values=255), board.square_m
    bits = DICTIONARIES[board.dictionary][0] + 2
    ratio = board.marker_m / board.square_m
    for cells in range(bits, FINEST_SQUARE + 1):
        marker = ratio * cells
        whole = round(marker)
        if abs(marker - whole) < 1e-6 * cells and whole % bits == 0 and (cells - whole) % 2 == 0:
            image = _charuco_board(board).generateImage(
                (board.columns * cells, board.rows * cells), marginSize=0
            )
            return np.pad(
                np.asarray(image, np.uint8), cells, constant_values=255
            ), board.square_m / cells
    raise ValueError(
        f"marker_m: {board.marker_m!r} has no common cell with square_m = {board.square_m!r}"
    )


@lru_cache(maxsize=8)
def _charuco_board(board: Board) -> cv2.aruco.CharucoBoard:
    size = (board.columns, board.rows)
    charuco = cv2.aruco.CharucoBoard(
        size, board.square_m, board.marker_m, dictionary_of(board.dictionary)
    )
    charuco.setLegacyPattern(board.legacy)
    return charuco


@lru_cache(maxsize=8)
def _charuco_detector(board: Board) -> cv2.aruco.CharucoDetector:
    return cv2.aruco.CharucoDetector(_charuco_board(board))


def _spans_a_plane(ids: Whole, board: Board) -> bool:
    columns = ids % (board.columns - 1)
    rows = ids // (board.columns - 1)
    return len(np.unique(columns)) >= 2 and len(np.unique(rows)) >= 2


def _homography(found: FoundCorners, board: Board) -> Array | None:
    H, _ = cv2.findHomography(board.corners_o[found.ids, :2] / board.square_m, found.corners_px)
    return None if H is None else np.asarray(H, np.float64)  # pyright: ignore[reportUnnecessaryComparison]


def _edge_directions(found: FoundCorners, board: Board) -> Array | None:
    """Directions of the board's x and y at every corner in the image, (n, 2, 2): [:, 0] along x;
    unit vectors.
    """
    H = _homography(found, board)
    if H is None:
        return None
    at = board.corners_o[found.ids, :2] / board.square_m
    p = np.column_stack((at, np.ones(len(at)))) @ H.T
    along = [(H[:2, k] - (p[:, :2] / p[:, 2:]) * H[2, k]) / p[:, 2:] for k in (0, 1)]
    return np.stack([d / np.linalg.norm(d, axis=1, keepdims=True) for d in along], axis=1)


def _pitch_px(points: Array, ids: Whole, board: Board) -> Array:
    """Distance to the nearest neighbour on the grid, per corner; the smallest one of all where it
    has none.
    """
    width = board.columns - 1
    grid = np.full((board.rows + 1, board.columns + 1, 2), np.nan)
    rows = ids // width + 1
    columns = ids % width + 1
    grid[rows, columns] = points
    steps = [np.linalg.norm(grid[rows + dr, columns + dc] - points, axis=1)
             for dr, dc in ((0, 1), (0, -1), (1, 0), (-1, 0))]  # fmt: skip
    nearest = np.where(np.isnan(steps), np.inf, steps).min(axis=0)
    known = nearest[np.isfinite(nearest)]
    return np.where(np.isfinite(nearest), nearest, known.min() if len(known) else 0.0)
