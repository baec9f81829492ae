"""``path-handoff export FILE.db3``: a RealSense recording as what every program reads.

NAME/000001.png ...      colour
NAME/depth/000001.png    depth in mm as the colour camera sees it, 16 bits, 0 where there is none
NAME/stamps.csv          when each was taken
NAME.camera.toml         the colour camera by its maker's calibration, unless another is given
"""

from __future__ import annotations

import csv
import sys
from datetime import UTC, datetime
from pathlib import Path

import cv2
import numpy as np

from drivers.interfaces import CameraError, PartError
from drivers.perception.stamp_clock import Domain
from drivers.realsense.camera import RealSenseConfig
from drivers.realsense.recorded import RealSenseRecording, RecordedPair
from drivers.realsense.registration import DepthRegistration
from drivers.rig.calibration_file import (
    VERSION,
    CameraCalibration,
    CameraTable,
    Quality,
    check_serial,
    check_size,
    read_camera,
    write_calibration,
)
from missions.options.runs import ExportOptions
from path.camera.model import CameraModel

STAMPS = "stamps.csv"
FAST = (cv2.IMWRITE_PNG_COMPRESSION, 1)


def export_recording(options: ExportOptions) -> int:
    """Writes the images, and says how many there are. Raises PartError; what was written until then stays."""
    if options.tum or options.csv:
        raise PartError("--tum and --csv are of a run's logs", f"leave them out for {options.folder}")
    file = options.folder
    if not file.is_file():
        raise PartError(f"{file}: there is no such file", "name a RealSense recording (.db3, .bag)")
    recording = RealSenseRecording(file)
    out = options.out or file.with_suffix("")
    if out.exists() and any(out.iterdir()):
        raise PartError(f"{out} is not empty", "name another folder with --out")
    (out / "depth").mkdir(parents=True, exist_ok=True)
    color, calibration = _camera(recording, options.calibration, out, file)
    believed = RealSenseConfig()
    limits_m = believed.min_depth_m, believed.max_depth_m
    try:
        registration = DepthRegistration(recording.depth, color, recording.T_color_depth, recording.unit_m, limits_m)
    except ValueError as error:
        raise PartError(f"{file}: depth cannot be registered to colour: {error}", "name its --calibration") from error
    domain, frames = None, 0
    with (out / STAMPS).open("w", newline="", encoding="utf-8") as lines:
        stamps = csv.writer(lines)
        stamps.writerow(("file", "stamp_ns"))
        for frames, pair in enumerate(recording.pairs(), 1):
            domain, name = pair.domain, f"{frames:06d}.png"
            _write(out, name, pair, registration)
            stamps.writerow((name, pair.stamp_ns))
    if not frames:
        raise PartError(f"{file}: colour and depth were never taken together", "is the file whole?")
    clock = "its camera's own clock" if domain is Domain.HARDWARE else "a computer's clock"
    sys.stdout.write(f"{out}: {frames} frames with depth, stamped by {clock}; {calibration}\n")
    return 0


def _camera(recording: RealSenseRecording, given: Path | None, out: Path, file: Path) -> tuple[CameraModel, Path]:
    """The colour camera, and the file that says so."""
    if given is not None:
        calibration = read_camera(given)
        check_serial(calibration.serial, recording.serial, str(file))
        model = calibration.camera.model()
        check_size((model.width, model.height), recording.color_size, str(file))
        return model, given
    try:
        model = recording.factory_color()
    except CameraError as error:
        raise PartError(f"{file}: {error}", "calibrate the camera and name the file with --calibration") from error
    k1, k2, p1, p2, k3 = model.distortion
    table = CameraTable(
        model.width, model.height, model.fx, model.fy, model.cx, model.cy, (k1, k2, p1, p2, k3)
    )  # fmt: skip
    written = out.with_name(f"{out.name}.camera.toml")
    made = datetime.now(UTC).isoformat(timespec="seconds")
    source = f"the maker's calibration in {file.name}"
    unknown = Quality(rms_px=0.0, held_out_px=0.0, views=0, corners=0, coverage=0.0)
    write_calibration(
        written,
        CameraCalibration(
            "camera", VERSION, made, recording.serial, source, "", table, {}, unknown, "fair", ("made of no views",)
        ),
    )
    return model, written


def _write(out: Path, name: str, pair: RecordedPair, registration: DepthRegistration) -> None:
    depth_mm = registration.register(pair.depth)
    for path, pixels in ((out / name, pair.color), (out / "depth" / name, depth_mm)):
        if not cv2.imwrite(str(path), np.ascontiguousarray(pixels), FAST):
            raise PartError(f"{path} cannot be written", "free some disk, or name another folder with --out")
