"""A photograph of a board of markers, as a TOML file describes it."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.interfaces import PartError
from drivers.rig.tables import RigError, decode_table, read_toml
from path.bounds import Bounds
from path.camera.model import CameraModel
from path.geometry.transforms import Matrix
from path.marker.layout import DICTIONARIES
from path.marker.photometric.texture import dictionary_of

REMEDY = "correct the board's file: docs/evaluation.md describes it"


@dataclass(frozen=True, slots=True)
class BoardCamera:
    """Table ``[camera]``: calibration of the photograph, px and OpenCV's Brown-Conrady coefficients."""

    fx: Annotated[float, Bounds(10.0, 100_000.0, "px")]
    fy: Annotated[float, Bounds(10.0, 100_000.0, "px")]
    cx: Annotated[float, Bounds(0.0, 100_000.0, "px")]
    cy: Annotated[float, Bounds(0.0, 100_000.0, "px")]
    distortion: Annotated[tuple[float, float, float, float, float], Bounds(-100.0, 100.0, "of 1")] = (
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
    )


@dataclass(frozen=True, slots=True)
class BoardFile:
    """The file. Paths are relative to it.

    Attributes:
        image: the photograph.
        dictionary: name of one of OpenCV's dictionaries, or a file as its ``writeDictionary`` gives it.
        rows, columns, first_id: markers, numbered along rows from the top-left one as printed.
        pitch_m: from marker to marker; side_m: of the black frame, nominal (it is estimated from the photograph).
    """

    image: Path
    dictionary: str
    rows: Annotated[int, Bounds(1, 1000, "markers")]
    columns: Annotated[int, Bounds(1, 1000, "markers")]
    pitch_m: Annotated[float, Bounds(0.002, 5.0)]
    side_m: Annotated[float, Bounds(0.001, 5.0)]
    camera: BoardCamera
    first_id: Annotated[int, Bounds(0, 1023, "(an id)")] = 0

    def __post_init__(self) -> None:
        if self.rows * self.columns < 4:
            raise ValueError(f"rows, columns: {self.rows} x {self.columns} are not at least four markers")
        if self.side_m >= self.pitch_m:
            raise ValueError(f"side_m, pitch_m: {self.side_m} and {self.pitch_m} leave no space between markers")


@dataclass(frozen=True, slots=True, eq=False)
class BoardPhotograph:
    """A photograph and what is on it.

    Attributes:
        grey: uint8 (h, w). ``patterns``: by id, cells with a white border, 0 black and 1 white.
        centres_m: by id, centre of the marker, x right and y down as printed, shape (2,).
    """

    file: BoardFile
    grey: NDArray[np.uint8]
    camera: CameraModel
    dictionary: cv2.aruco.Dictionary
    patterns: dict[int, Matrix]
    centres_m: dict[int, NDArray[np.float64]]


def read_board(path: Path) -> BoardPhotograph:
    """The board that a TOML file describes.

    Raises:
        PartError: naming the file, and the key where there is one.
    """
    try:
        table = read_toml(path)
        described = decode_table(table, BoardFile, path.name, path.parent)
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise PartError(f"{path}: {error}", REMEDY) from error
    except RigError as error:
        raise PartError(str(error), REMEDY) from error
    grey = cv2.imread(str(described.image), cv2.IMREAD_GRAYSCALE)
    if grey is None:
        raise PartError(f"{path.name}: image: {described.image} is no image that can be read", REMEDY)
    height, width = grey.shape
    seen = described.camera
    try:
        camera = CameraModel(width, height, seen.fx, seen.fy, seen.cx, seen.cy, seen.distortion)
    except ValueError as error:
        raise PartError(f"{path.name}: camera: {error}", REMEDY) from error
    dictionary = dictionary_named(described.dictionary, path)
    count, known = described.rows * described.columns, len(dictionary.bytesList)
    if described.first_id + count > known:
        raise PartError(f"{path.name}: first_id: {count} markers from {described.first_id} on, of {known} there are",
                        REMEDY)  # fmt: skip
    ids = range(described.first_id, described.first_id + count)
    places = [np.array([k % described.columns, k // described.columns]) * described.pitch_m for k in range(count)]
    return BoardPhotograph(
        described,
        np.asarray(grey, dtype=np.uint8),
        camera,
        dictionary,
        {i: framed_pattern(dictionary, i) for i in ids},
        dict(zip(ids, places, strict=True)),
    )


def dictionary_named(name: str, path: Path) -> cv2.aruco.Dictionary:
    """One of OpenCV's, or a file beside ``path``. Raises PartError when it is neither."""
    if name in DICTIONARIES:
        return dictionary_of(name)
    file, dictionary = path.parent / name, cv2.aruco.Dictionary()
    if file.is_file():
        try:
            storage = cv2.FileStorage(str(file), cv2.FILE_STORAGE_READ)
            if dictionary.readDictionary(storage.root()):
                return dictionary
        except (cv2.error, SystemError):
            pass  # said below
    raise PartError(f"{path.name}: dictionary: {name!r} is none of OpenCV's, and no file of one", REMEDY)


def framed_pattern(dictionary: cv2.aruco.Dictionary, marker_id: int) -> Matrix:
    """Cells of a marker within a border of white ones, 0 black and 1 white."""
    drawn = cv2.aruco.generateImageMarker(dictionary, marker_id, dictionary.markerSize + 2, borderBits=1)
    return np.pad((drawn > 127).astype(np.float64), 1, constant_values=1.0)
