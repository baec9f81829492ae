"""Calibrations on disk: TOML that a person can read, with a version, tied to one camera and one
image size.

A rig names them: ``[sender.camera] calibration = "d1.camera.toml"`` instead of the numbers, and
``[sender.mount.marker] calibration = "d1.mount.toml"`` instead of measures.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeVar

import numpy as np

from drivers.interfaces import CameraError
from drivers.rig.foreign_calibration import foreign_calibration
from drivers.rig.tables import RigError, decode_table, read_toml
from drivers.rig.toml_text import toml_text
from drivers.text_file import read_file
from path.bounds import Bounds
from path.camera.model import CameraModel, Nine
from path.camera.thinning import Thinning
from path.geometry.rotation import R_from_quat, normalized, quat_from_R
from path.geometry.transforms import Pose
from path.values import frozen

VERSION = 1
CAMERA_REMEDY = "make it again with `path-handoff calibrate camera`"
MOUNT_REMEDY = "make it again with `path-handoff calibrate mount`"
T = TypeVar("T")
Vec3 = tuple[float, float, float]


class CalibrationError(CameraError):
    """A calibration cannot be read or written, or does not belong to what it is used with."""


@frozen
class CameraTable:
    """Intrinsics at exactly this stream size; distortion is Brown–Conrady k1 k2 p1 p2 k3.

    ``doubts``: as ``CameraModel.doubts``; empty where nothing is stated, and then the method's own
    figure is used. ``thinning``: how the camera leaves out pixels; None where it does not.
    """

    # wider ones could not say on the link where their boxes are (drivers.link.units)
    width: Annotated[int, Bounds(16, 8191, "px")]
    height: Annotated[int, Bounds(16, 8191, "px")]
    fx: Annotated[float, Bounds(10.0, 100000.0, "px")]
    fy: Annotated[float, Bounds(10.0, 100000.0, "px")]
    cx: Annotated[float, Bounds(0.0, 16384.0, "px")]
    cy: Annotated[float, Bounds(0.0, 16384.0, "px")]
    distortion: Annotated[tuple[float, float, float, float, float], Bounds(-20.0, 20.0, "of 1")]
    doubts: Annotated[tuple[Nine, ...], Bounds(-1e4, 1e4, "as the parameter")] = ()
    thinning: Thinning | None = None

    def __post_init__(self) -> None:
        if not (0 <= self.cx < self.width and 0 <= self.cy < self.height):
            raise ValueError(
                f"the principal point ({self.cx:g}, {self.cy:g}) is outside {self.width}x{self.height}: "
                "this calibration is of another stream size"
            )

    @classmethod
    def of(cls, camera: CameraModel) -> Self:
        """Return the table of a camera."""
        return cls(
            camera.width,
            camera.height,
            camera.fx,
            camera.fy,
            camera.cx,
            camera.cy,
            camera.distortion,
            camera.doubts,
            camera.thinning,
        )

    def model(self) -> CameraModel:
        """Raise ValueError for a distortion that cannot be inverted."""
        return CameraModel(
            self.width,
            self.height,
            self.fx,
            self.fy,
            self.cx,
            self.cy,
            self.distortion,
            self.doubts,
            self.thinning,
        )


@frozen
class Quality:
    """The quality of a calibration: rms of corners in px, of the solution and of views that were
    left out.
    """

    rms_px: float
    held_out_px: float
    views: int
    corners: int
    coverage: float


@frozen
class CameraCalibration:
    """A camera's calibration as written.

    Attributes:
        made: date and time, ISO 8601.
        serial: of the camera, "" when it is not known.
        source, board: what it was made from, for people.
        standard_errors: of each parameter.
        grade: good, or fair or weak where ``weak`` names what its views lacked
            (docs/calibration.md).
    """

    kind: Literal["camera"]
    version: int
    made: str
    serial: str
    source: str
    board: str
    camera: CameraTable
    standard_errors: Annotated[dict[str, float], Bounds(0.0, 1e6, "as the parameter")]
    quality: Quality
    grade: Literal["good", "fair", "weak"] = "good"
    weak: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        _check_version(self.version)


def made_of_no_views(
    camera: CameraModel,
    serial: str,
    source: str,
    grade: Literal["fair", "weak"],
    weak: str,
) -> CameraCalibration:
    """Return the calibration of a camera that somebody else calibrated: nothing is known of how.

    Args:
        serial, source: as of the file.
        weak: what its grade is for.
    """
    return CameraCalibration(
        kind="camera",
        version=VERSION,
        made=datetime.now(UTC).isoformat(timespec="seconds"),
        serial=serial,
        source=source,
        board="",
        camera=CameraTable.of(camera),
        standard_errors={},
        quality=Quality(rms_px=0.0, held_out_px=0.0, views=0, corners=0, coverage=0.0),
        grade=grade,
        weak=(weak,),
    )


@frozen
class MarkerPrint:
    """A marker of the layout that a mount belongs to."""

    id: Annotated[int, Bounds(0, 1023, "(an id)")]
    side_m: Annotated[float, Bounds(0.005, 2.0)]


@frozen
class MountCalibration:
    """``T_v_c1`` as written: where D1's camera is, seen from the marker.

    Attributes:
        serial: of D1's camera, "" when it is not known. ``markers``: the layout that defines frame
            ``v``.
        position_v_m, q_v_c: of ``T_v_c1``, quaternion wxyz.
        position_sigma_m, rotation_sigma_deg: standard errors, along the axes of ``v``.
    """

    kind: Literal["mount"]
    version: int
    made: str
    serial: str
    source: str
    markers: tuple[MarkerPrint, ...]
    position_v_m: Annotated[Vec3, Bounds(-3.0, 3.0)]
    q_v_c: Annotated[tuple[float, float, float, float], Bounds(-1.1, 1.1, "of 1")]
    position_sigma_m: Annotated[Vec3, Bounds(0.0, 1.0)]
    rotation_sigma_deg: Annotated[Vec3, Bounds(0.0, 90.0)]
    pairs: Annotated[int, Bounds(0, 1_000_000, "pairs")] = 0
    rms_px: Annotated[float, Bounds(0.0, 1000.0)] = 0.0
    notes: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        _check_version(self.version)
        normalized(self.q_v_c)

    @property
    def T_v_c(self) -> Pose:
        return Pose(np.array(R_from_quat(normalized(self.q_v_c))), np.array(self.position_v_m))

    @property
    def largest_sigmas(self) -> tuple[float, float]:
        """Metres and degrees."""
        return max(self.position_sigma_m), max(self.rotation_sigma_deg)


def _check_version(version: int) -> None:
    if version != VERSION:
        raise ValueError(
            f"version {version} of this file is not known; this program writes and reads {VERSION}"
        )


def read_camera(file: Path) -> CameraCalibration:
    """Raise CalibrationError naming the file, and the key where there is one."""
    return _read(file, CameraCalibration, CAMERA_REMEDY)


def read_mount(file: Path) -> MountCalibration:
    """Raise CalibrationError naming the file, and the key where there is one."""
    return _read(file, MountCalibration, MOUNT_REMEDY)


MADE_BY = "Made by `path-handoff calibrate"  # the sign of every file and picture of these commands


def write_calibration(file: Path, calibration: CameraCalibration | MountCalibration) -> None:
    """Raise CalibrationError when it cannot be written."""
    key = (
        "[sender.camera]" if isinstance(calibration, CameraCalibration) else "[sender.mount.marker]"
    )
    comment = f'{MADE_BY} {calibration.kind}`. In a rig: {key} calibration = "{file.name}"'
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(toml_text(_plain(asdict(calibration)), comment), "utf-8")
    except OSError as error:
        raise CalibrationError(
            f"cannot write {file}: {error.strerror}", "name another file with --out"
        ) from error


def quaternion(pose: Pose) -> tuple[float, float, float, float]:
    """wxyz of a pose's rotation."""
    return normalized(quat_from_R(pose.R))


def check_serial(
    calibrated: str,
    camera: str,
    what: str,
) -> None:
    """Raise CalibrationError when both serial numbers are known and differ."""
    if calibrated and camera and calibrated != camera:
        raise CalibrationError(
            f"{what}: the calibration is of the camera with serial number {calibrated}, this one is {camera}",
            "name the calibration of this very camera in the rig, or calibrate it: `path-handoff calibrate camera`",
        )


def check_size(
    calibrated: tuple[int, int],
    stream: tuple[int, int],
    what: str,
) -> None:
    """Raise CalibrationError when the sizes (width, height) differ."""
    if calibrated != stream:
        raise CalibrationError(
            f"{what}: the calibration is for {calibrated[0]}x{calibrated[1]} px but the frames are "
            f"{stream[0]}x{stream[1]} px",
            "use the calibration of this stream, or set the stream to the calibrated size",
        )


def _read(
    file: Path,
    kind: type[T],
    remedy: str,
) -> T:
    try:
        return decode_table(read_toml(file), kind, file.name, file.parent)
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        known = _of_another_program(file) if isinstance(error, tomllib.TOMLDecodeError) else None
        if known is not None:
            what, remedy = known
            reason = f"{what}; {remedy}"  # a rig tells what is wrong with all of it, and one remedy
        raise CalibrationError(f"{file}: {reason}", remedy) from error
    except RigError as error:
        raise CalibrationError(str(error), remedy) from error


def _of_another_program(file: Path) -> tuple[str, str] | None:
    """Return what a file is that is no TOML, and how to go on, where that is known."""
    return foreign_calibration(read_file(file).decode("utf-8", errors="replace"), file.name)


def _plain(value: Any) -> Any:
    """Numbers short enough to read: ten digits, and no NaN. What is None is left out."""
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items() if item is not None}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return float(f"{value:.10g}") if math.isfinite(value) else 0.0
    return value
