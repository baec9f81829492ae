"""``path-handoff export FILE.db3``: a RealSense recording, or a bag of ROS, as what every program
reads.

NAME/000001.png ...      colour
NAME/depth/000001.png    depth in mm as the colour camera sees it, 16 bits, 0 where there is none;
                         no such folder for a bag of colour alone
NAME/stamps.csv          when each was taken
NAME.camera.toml         the colour camera by its maker's calibration, unless another is given
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np

from drivers.interfaces import CameraError, PartError
from drivers.perception.stamp_clock import Domain
from drivers.realsense.camera import RealSenseConfig
from drivers.realsense.recorded import RealSenseRecording
from drivers.realsense.registration import DepthRegistration
from drivers.recordings.ros_bag import ros_bag_at
from drivers.recordings.ros_images import FilmFrame, RosImages
from drivers.rig.calibration_file import (
    CameraCalibration,
    check_serial,
    check_size,
    made_of_no_views,
    read_camera,
    write_calibration,
)
from missions.ground.options.runs import ExportOptions
from missions.ground.run_folder import unless_refused
from path.arrays import Depths, Image
from path.camera.lenses import StandIn
from path.camera.model import CameraModel
from path.values import frozen

STAMPS = "stamps.csv"
FAST = (cv2.IMWRITE_PNG_COMPRESSION, 1)


class Film(Protocol):
    """What is written out: a bag of ROS (``RosImages``) is one as it is.

    ``serial``: of its camera, "" when it is not known; ``clock``: whose its
    stamps are; ``torn``: so many frames were not whole, and were left out.
    """

    serial: str
    color_size: tuple[int, int]
    clock: str

    @property
    def has_depth(self) -> bool: ...

    @property
    def torn(self) -> int: ...

    def factory_color(self) -> StandIn | None:
        """The colour camera by the film itself; None where it does not say. Raises CameraError."""
        ...

    def frames(self, color: CameraModel | None) -> Iterator[FilmFrame]:
        """Yield what was taken together. Raises PartError at once for depth that does not belong
        to that camera.
        """
        ...


class RealSenseFilm:
    """A recording of librealsense."""

    has_depth = True
    torn = 0

    def __init__(self, file: Path) -> None:
        self._file, self._recording = file, RealSenseRecording(file)
        self.serial = self._recording.serial
        self.color_size = self._recording.color_size
        self.clock = "a computer's clock"

    def factory_color(self) -> StandIn:
        return self._recording.factory_color()

    def frames(self, color: CameraModel | None) -> Iterator[FilmFrame]:
        assert color is not None  # a RealSense recording says its own
        recording = self._recording
        believed = RealSenseConfig()
        limits_m = believed.min_depth_m, believed.max_depth_m
        try:
            registration = DepthRegistration(
                recording.depth,
                color,
                recording.T_color_depth,
                recording.unit_m,
                limits_m,
            )
        except ValueError as error:
            raise PartError(
                f"{self._file}: depth cannot be registered to colour: {error}",
                "name its --calibration",
            ) from error
        for pair in recording.pairs():
            if pair.domain is Domain.HARDWARE:
                self.clock = "its camera's own clock"
            yield FilmFrame(pair.stamp_ns, pair.color, registration.register(pair.depth))


def export_recording(options: ExportOptions) -> int:
    """Write the images, and say how many there are. Raises PartError; what was written until then
    stays.

    Nothing is written before the first frame: what is refused leaves nothing that a second try
    would meet.
    """
    if options.tum or options.csv:
        raise PartError(
            "--tum and --csv are of a run's logs", f"leave them out for {options.folder}"
        )
    file = options.folder
    if not file.exists():
        raise PartError(f"{file}: there is no such file", "name a RealSense recording (.db3, .bag)")
    of_ros = ros_bag_at(file) is not None
    out = options.out or (file / "export" if file.is_dir() else file.with_suffix(""))
    if out.exists() and out.is_dir() and any(out.iterdir()):
        raise PartError(f"{out} is not empty", "name another folder with --out, or remove it")
    with unless_refused(out):
        film = RosImages(file) if of_ros else RealSenseFilm(file)
        camera = (
            _given(film, options.calibration, file)
            if options.calibration
            else _factory(film, out, file)
        )
        frames = _write_all(film, camera, out)
        if not frames:
            raise PartError(
                f"{file}: colour and depth were never taken together", "is the file whole?"
            )
    named = "" if camera.file is None else str(camera.file)
    depth = "with depth" if film.has_depth else "without depth (there is none in it)"
    torn = f", {film.torn} that were torn left out" if film.torn else ""
    sys.stdout.write(
        f"{out}: {frames} frames {depth}{torn}, stamped by {film.clock}; {named}{camera.note}\n"
    )
    return 0


@frozen
class _Camera:
    """The colour camera, the file that says so, what of it is still to be written, and a word about
    it.
    """

    model: CameraModel | None
    file: Path | None
    unwritten: CameraCalibration | None = None
    note: str = ""


def _write_all(
    film: Film,
    camera: _Camera,
    out: Path,
) -> int:
    """Return how many frames there are."""
    frames = 0
    with ExitStack() as stack:
        stamps: Any = None
        for frames, frame in enumerate(film.frames(camera.model), 1):
            if stamps is None:
                (out / "depth" if film.has_depth else out).mkdir(parents=True, exist_ok=True)
                if camera.file is not None and camera.unwritten is not None:
                    write_calibration(camera.file, camera.unwritten)
                lines = stack.enter_context((out / STAMPS).open("w", newline="", encoding="utf-8"))
                stamps = csv.writer(lines)
                stamps.writerow(("file", "stamp_ns"))
            name = f"{frames:06d}.png"
            _write(out / name, frame.color)
            if frame.depth_mm is not None:
                _write(out / "depth" / name, frame.depth_mm)
            stamps.writerow((name, frame.stamp_ns))
    return frames


def _given(
    film: Film,
    given: Path,
    file: Path,
) -> _Camera:
    """The colour camera by a calibration of one's own."""
    calibration = read_camera(given)
    check_serial(calibration.serial, film.serial, str(file))
    model = calibration.camera.model()
    check_size((model.width, model.height), film.color_size, str(file))
    return _Camera(model, given)


def _factory(
    film: Film,
    out: Path,
    file: Path,
) -> _Camera:
    """The colour camera as its maker calibrated it."""
    try:
        lens = film.factory_color()
    except CameraError as error:
        raise PartError(
            f"{file}: {error}", "calibrate the camera and name the file with --calibration"
        ) from error
    if lens is None:
        return _Camera(None, None, note="it does not say what lens it has: calibrate the camera")
    written = out.with_name(f"{out.name}.camera.toml")
    source = f"the maker's calibration in {file.name}"
    if written.exists() and read_camera(written).source != source:
        raise PartError(
            f"{written} is there, and is not {source}",
            "name it with --calibration, or another --out",
        )
    model = lens.camera
    calibration = made_of_no_views(model, film.serial, source, "fair", "made of no views")
    off = (
        f" (its lens as Brown-Conrady, off by {lens.worst_px:.3f} px at most)"
        if lens.worst_px
        else ""
    )
    return _Camera(model, written, calibration, off)


def _write(path: Path, pixels: Image | Depths) -> None:
    if not cv2.imwrite(str(path), np.ascontiguousarray(pixels), FAST):
        raise PartError(
            f"{path} cannot be written", "free some disk, or name another folder with --out"
        )
