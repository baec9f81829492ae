"""The options of ``path-handoff calibrate``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tyro

from missions.ground.options.words import FileName, OutFolder
from path.bounds import Bounds
from path.values import frozen


@frozen
class BoardOptions:
    """The printed board, as measured on the print."""

    board: Literal["charuco", "chessboard"] = "charuco"
    """Pattern. ChArUco may be seen in part, so it reaches the corners of the image: there the
    distortion shows.
    """

    squares: Annotated[str, tyro.conf.arg(metavar="COLUMNSxROWS")] = "10x7"
    """Squares of the board, of either pattern: a chessboard of 10x7 squares has 9x6 inner
    corners.
    """

    square_m: Annotated[float, Bounds(0.002, 1.0)] = 0.030
    """Side of a square."""

    marker_m: Annotated[float, Bounds(0.001, 1.0)] = 0.0225
    """Side of the black frame of a ChArUco board's markers."""

    dictionary: str = "DICT_4X4_50"
    """OpenCV's dictionary of these markers."""

    legacy: bool = False
    """The board is a ChArUco one as OpenCV drew it before 4.6; of images and films that is also
    found out.
    """


@frozen
class CalibrateCameraOptions(BoardOptions):
    """Calibrate a camera from views of a board: of images, a video, or a rig's camera as it
    runs.
    """

    images: OutFolder = None
    """Folder of images, one view each."""

    video: FileName = None
    """Video file, image folder with stamps, or .mcap log: still and different views are chosen from
    it.
    """

    rig: Annotated[str, tyro.conf.arg(metavar="NAME|FILE")] = ""
    """Rig whose camera is to be calibrated as it runs."""

    role: Literal["sender", "receiver"] = "sender"
    """Whose camera of the rig."""

    size: Annotated[str, tyro.conf.arg(metavar="WIDTHxHEIGHT")] = "1280x720"
    """With --rig: the size of the stream in px, of a camera that has no calibration in the rig
    yet.
    """

    views: Annotated[int, Bounds(3, 10_000, "views")] = 40
    """Views to choose from a video, or to take with a running camera."""

    seconds: Annotated[float, Bounds(1.0, 36_000.0)] = 300.0
    """A running camera is given up after this time."""

    serial: str = ""
    """Serial number of the camera, to tie the calibration to; a running camera that knows its own
    tells it itself.
    """

    out: Annotated[Path, tyro.conf.arg(metavar="FILE")] = Path("camera.toml")
    """The calibration; beside it a picture of the same name, and the views that a running camera
    gave.
    """


@frozen
class CalibrateMountOptions(BoardOptions):
    """Find where D1's camera is, seen from its marker (T_v_c1): from views of a board, or from a
    tape measure.
    """

    rig: Annotated[str, tyro.conf.arg(metavar="NAME|FILE")] = ""
    """Rig with the markers, and D1's camera and its calibration."""

    images: OutFolder = None
    """Images of D1's camera that show the board."""

    other_images: OutFolder = None
    """Images of another camera, of the same names and moments, that show the same board and D1's
    marker.
    """

    other_camera: FileName = None
    """Calibration of that other camera, as made by `path-handoff calibrate camera`."""

    measured: FileName = None
    """Instead of images: TOML file with what a tape measure and a protractor say
    (docs/calibration.md).
    """

    out: Annotated[Path, tyro.conf.arg(metavar="FILE")] = Path("mount.toml")
    """The calibration."""


@frozen
class CalibrateBoardOptions(BoardOptions):
    """Draw a board to print."""

    dpi: Annotated[int, Bounds(30, 4800, "dots per inch")] = 600
    """Dots per inch of the printer: cells become whole dots."""

    out: Annotated[Path, tyro.conf.arg(metavar="FILE")] = Path("board.png")
    """The picture, PNG."""


@frozen
class CalibrateMarkerOptions:
    """Draw D1's marker to print, or a plate of several in a row, and what a rig says of it."""

    ids: tuple[Annotated[int, Bounds(0, 1023, "(an id)")], ...] = (0,)
    """From left to right; their ids in the dictionary."""

    side_m: Annotated[float, Bounds(0.005, 1.0)] = 0.04
    """Side of the black frame."""

    gap_m: Annotated[float, Bounds(0.0, 1.0)] = 0.02
    """White between two black frames; the quiet zone takes a cell of each at least."""

    dictionary: str = "DICT_4X4_50"
    """OpenCV's dictionary; the rig's `marker_dictionary`."""

    out: Annotated[Path, tyro.conf.arg(metavar="FILE")] = Path("marker.svg")
    """The drawing, in millimetres, SVG: a browser prints it at its size."""


@frozen
class CalibrateImportOptions:
    """Read a camera's calibration that another program made: ROS, Kalibr, OpenCV, COLMAP,
    RealSense, DepthAI.
    """

    file: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
    """The calibration of the other program."""

    camera: str = ""
    """Which camera of the file, where there are several."""

    size: Annotated[str, tyro.conf.arg(metavar="WIDTHxHEIGHT")] = ""
    """Size of its images in px, of a file that does not say."""

    serial: str = ""
    """Serial number of the camera, to tie the calibration to."""

    out: Annotated[Path, tyro.conf.arg(metavar="FILE")] = Path("camera.toml")
    """The calibration."""


@frozen
class CalibrateExportOptions:
    """Write a camera's calibration for another program: ROS, Kalibr, OpenCV."""

    file: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
    """A calibration of `path-handoff calibrate camera`."""

    to: Literal["ros", "kalibr", "opencv"] = "ros"
    """Whose file it is to be: a camera_info of ROS, a camera chain of Kalibr, OpenCV's
    FileStorage.
    """

    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Where to; without it, beside the calibration."""


@frozen
class CalibrateOptions:
    """Calibrate a camera, or where it sits relative to the marker; read or write another program's
    calibration; or draw a board, or the marker, to print.
    """

    what: (
        Annotated[CalibrateCameraOptions, tyro.conf.subcommand("camera")]
        | Annotated[CalibrateMountOptions, tyro.conf.subcommand("mount")]
        | Annotated[CalibrateImportOptions, tyro.conf.subcommand("import")]
        | Annotated[CalibrateExportOptions, tyro.conf.subcommand("export")]
        | Annotated[CalibrateBoardOptions, tyro.conf.subcommand("board")]
        | Annotated[CalibrateMarkerOptions, tyro.conf.subcommand("marker")]
    )
