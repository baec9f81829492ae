"""A set of photographs of one printed board, as a TOML file describes it."""

from __future__ import annotations

import math
import tomllib
from pathlib import Path
from typing import Annotated, Literal

import cv2
import numpy as np

from drivers.interfaces import PartError
from drivers.recordings.recording import IMAGE_SUFFIXES
from drivers.rig.tables import RigError, decode_table, read_toml
from path.bounds import Bounds
from path.calibration.board import Board
from path.geometry.transforms import Matrix
from path.marker.layout import DICTIONARIES
from path.marker.photometric.texture import dictionary_of
from path.values import frozen

REMEDY = "correct the set's file: docs/real.md describes it"
FEWEST_MARKERS = 4
# of a side, y down, as printed
GRID_CORNERS = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])


Focal = Annotated[float, Bounds(10.0, 100_000.0, "px")]
Centre = Annotated[float, Bounds(0.0, 100_000.0, "px")]
Coefficients = tuple[float, float, float, float, float]


@frozen
class SetCamera:
    """Table ``[camera]``: calibration of the photographs, px and OpenCV's Brown-Conrady
    coefficients.
    """

    fx: Focal
    fy: Focal
    cx: Centre
    cy: Centre
    distortion: Annotated[Coefficients, Bounds(-100.0, 100.0, "of 1")] = (0.0, 0.0, 0.0, 0.0, 0.0)


@frozen
class RealSetFile:
    """The file.

    Attributes:
        images: a folder of photographs, or one; relative to the file, or to the folder that the
            command names.
        pattern: "charuco", "chessboard", or "grid": markers alone, in rows.
        columns, rows: squares of a ChArUco board or chessboard; markers of a grid.
        pitch_m: side of a square; from marker to marker in a grid.
        side_m: of the markers' black frame, nominal (it is measured on the photographs); 0 on a
            chessboard.
        dictionary: of the markers: one of OpenCV's, or a file as its ``writeDictionary`` gives it
            (a grid's only).
        first_id: of a grid: markers are numbered along rows from the top-left one.
        legacy: a ChArUco board as OpenCV drew it before 4.6.
        camera: calibration of the photographs; None: from the set itself.
        gravity_sigma_deg: how well gravity is known between marker and camera, per axis; it is
            drawn from the board's pose with that error. ``down``: gravity in a marker's frame (x
            right, y up as printed, z to the viewer).
        scaled_side_m: errors are given for a marker of this side.
        bend_order: order of the polynomials by which lens and paper may leave the board's plane.
        flat: whether the board is stiff, so that a marker's true pose is that of the whole board's
            plane; of a curled sheet it is that of the surface under the marker, as the polynomials
            tell it.
    """

    images: Path
    pattern: Literal["charuco", "chessboard", "grid"]
    columns: Annotated[int, Bounds(1, 1000, "(a number)")]
    rows: Annotated[int, Bounds(1, 1000, "(a number)")]
    pitch_m: Annotated[float, Bounds(0.002, 5.0)]
    side_m: Annotated[float, Bounds(0.0, 5.0)] = 0.0
    dictionary: str = "DICT_4X4_50"
    first_id: Annotated[int, Bounds(0, 1023, "(an id)")] = 0
    legacy: bool = False
    camera: SetCamera | None = None
    gravity_sigma_deg: Annotated[float, Bounds(0.0, 10.0, above=True)] = 0.5
    down: Annotated[tuple[float, float, float], Bounds(-1.01, 1.01, "of 1")] = (0.0, -1.0, 0.0)
    scaled_side_m: Annotated[float, Bounds(0.001, 10.0)] = 0.040
    bend_order: Annotated[int, Bounds(0, 4, "(an order)")] = 2
    flat: bool = True

    def __post_init__(self) -> None:
        if self.pattern == "grid":
            if self.camera is None:
                raise ValueError(
                    "camera: a grid of markers cannot tell its camera: name its calibration"
                )
            if self.columns * self.rows < FEWEST_MARKERS:
                few = f"{self.rows} x {self.columns} are not {FEWEST_MARKERS} markers"
                raise ValueError(f"rows, columns: {few}")
            if not 0.0 < self.side_m < self.pitch_m:
                sides = f"{self.side_m} and {self.pitch_m}"
                raise ValueError(f"side_m, pitch_m: {sides} leave no space between markers")
        elif self.dictionary not in DICTIONARIES:
            known = ", ".join(DICTIONARIES)
            raise ValueError(f"dictionary: {self.dictionary!r} is none of {known}")
        if not 0.99 < math.hypot(*self.down) < 1.01:
            raise ValueError(f"down: {self.down} is no direction of length 1")


@frozen(eq=False)
class PrintedMarker:
    """One marker on the board.

    Attributes:
        pattern: cells within a white border, 0 black and 1 white. ``corners_o``: (4, 3), metres in
            the board's frame (x right, y down as printed, z away from the viewer), as it was meant
            to be printed.
    """

    pattern: Matrix
    corners_o: Matrix


@frozen(eq=False)
class RealSet:
    """Photographs, the board's own corners (None of a grid) and its markers by id (none on a
    chessboard).
    """

    name: str
    file: RealSetFile
    images: tuple[Path, ...]
    board: Board | None
    dictionary: cv2.aruco.Dictionary | None
    markers: dict[int, PrintedMarker]


def read_set(path: Path, photographs: Path | None = None) -> RealSet:
    """The set that a TOML file describes.

    Args:
        photographs: what its paths are relative to, by default the file's own folder.

    Raises:
        PartError: naming the file, and the key where there is one.
    """
    base = photographs or path.parent
    try:
        described = decode_table(read_toml(path), RealSetFile, path.name, base)
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise PartError(f"{path}: {error}", REMEDY) from error
    except RigError as error:
        raise PartError(str(error), REMEDY) from error
    images = _images(described.images, path)
    if described.pattern == "grid":
        dictionary = dictionary_named(described.dictionary, base / path.name)
        count = described.columns * described.rows
        if described.first_id + count > len(dictionary.bytesList):
            raise PartError(
                f"{path.name}: first_id: the dictionary has {len(dictionary.bytesList)} markers",
                REMEDY,
            )
        return RealSet(path.stem, described, images, None, dictionary, _grid(described, dictionary))
    try:
        board = Board(
            described.pattern, described.columns, described.rows, described.pitch_m, described.side_m,
            described.dictionary, described.legacy,
        )  # fmt: skip
    except ValueError as error:
        raise PartError(f"{path.name}: {error}", REMEDY) from error
    dictionary = dictionary_named(described.dictionary, path)
    markers = {
        marker_id: PrintedMarker(framed_pattern(dictionary, marker_id), corners)
        for marker_id, corners in board.markers_o.items()
    }
    return RealSet(path.stem, described, images, board, dictionary if markers else None, markers)


def _images(place: Path, path: Path) -> tuple[Path, ...]:
    if place.is_dir():
        files = tuple(
            sorted(file for file in place.iterdir() if file.suffix.lower() in IMAGE_SUFFIXES)
        )
    else:
        files = (place,) if place.is_file() else ()
    if not files:
        raise PartError(f"{path.name}: images: {place} has no photograph", REMEDY)
    return files


def _grid(described: RealSetFile, dictionary: cv2.aruco.Dictionary) -> dict[int, PrintedMarker]:
    markers: dict[int, PrintedMarker] = {}
    for k in range(described.columns * described.rows):
        centre = np.array([k % described.columns, k // described.columns]) * described.pitch_m
        corners = np.column_stack([centre + described.side_m * GRID_CORNERS, np.zeros(4)])
        markers[described.first_id + k] = PrintedMarker(
            framed_pattern(dictionary, described.first_id + k), corners
        )
    return markers


def dictionary_named(name: str, path: Path) -> cv2.aruco.Dictionary:
    """Return one of OpenCV's dictionaries, or that of a file beside ``path``.

    Raises:
        PartError: when it is neither.
    """
    if name in DICTIONARIES:
        return dictionary_of(name)
    file = path.parent / name
    dictionary = cv2.aruco.Dictionary()
    if file.is_file():
        try:
            storage = cv2.FileStorage(str(file), cv2.FILE_STORAGE_READ)
            if dictionary.readDictionary(storage.root()):
                return dictionary
        except (cv2.error, SystemError):
            pass  # said below
    told = f"{path.name}: dictionary: {name!r} is none of OpenCV's, and no file of one"
    raise PartError(told, REMEDY)


def framed_pattern(dictionary: cv2.aruco.Dictionary, marker_id: int) -> Matrix:
    """Return the cells of a marker within a border of white ones, 0 black and 1 white."""
    size = dictionary.markerSize + 2
    drawn = cv2.aruco.generateImageMarker(dictionary, marker_id, size, borderBits=1)
    return np.pad((drawn > 127).astype(np.float64), 1, constant_values=1.0)
