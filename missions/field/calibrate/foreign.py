"""``path-handoff calibrate import``: a calibration that another program made, as PATH's own."""

from __future__ import annotations

from dataclasses import replace
from typing import TextIO

from drivers.interfaces import PartError
from drivers.rig.calibration_file import (
    MADE_BY,
    CalibrationError,
    CameraCalibration,
    made_of_no_views,
    write_calibration,
)
from drivers.rig.foreign_lens import ForeignError, foreign_lenses
from drivers.text_file import read_file
from missions.field.calibrate.camera import size_of
from missions.ground.held import held_file
from missions.ground.options.calibrate import CalibrateImportOptions
from missions.ground.run_folder import claim_result
from path.camera.lenses import Lens, StandIn, as_brown_conrady

# of a focal length whose file does not say: what weak sets of views leave, of its own length
FOCAL_SIGMA = 0.005


def import_camera(options: CalibrateImportOptions, out: TextIO) -> int:
    """Carry the command out; return 0 when the file was written. Raises PartError."""
    name, lens = _chosen(options)
    try:
        camera = as_brown_conrady(lens)
    except ValueError as error:
        raise CalibrationError(
            f"{options.file}: {name}: {error}",
            "calibrate a stream of less angle, or one that the camera undistorts",
        ) from error
    with held_file(options.out):
        claim_result(options.out, MADE_BY)
        write_calibration(options.out, _file_of(options, camera))
    _report(options, name, lens, camera, out)
    return 0


def _chosen(options: CalibrateImportOptions) -> tuple[str, Lens]:
    """Return the camera that is asked for, or the only one, and its name."""
    size = size_of(options.size) if options.size else None
    try:
        text = read_file(options.file).decode("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "this is no text"
        raise PartError(f"{options.file}: {reason}", "name a calibration's file") from error
    try:
        lenses = foreign_lenses(text, size)
    except ForeignError as error:
        raise CalibrationError(f"{options.file}: {error}", error.remedy) from error
    if not options.camera and len(lenses) == 1:
        return next(iter(lenses.items()))
    if options.camera not in lenses:
        wanted = f"no camera '{options.camera}'" if options.camera else f"{len(lenses)} cameras"
        raise PartError(
            f"{options.file}: {wanted} in it, but {', '.join(lenses)}", "name one with --camera"
        )
    return options.camera, lenses[options.camera]


def _file_of(options: CalibrateImportOptions, stand_in: StandIn) -> CameraCalibration:
    camera = stand_in.camera
    sigma_x = FOCAL_SIGMA * camera.fx
    sigma_y = FOCAL_SIGMA * camera.fy
    focal_doubt = (sigma_x, sigma_y, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    doubted = replace(camera, doubts=(focal_doubt,))
    return made_of_no_views(doubted, options.serial, options.file.name, "weak", "imported")


def _report(
    options: CalibrateImportOptions,
    name: str,
    lens: Lens,
    stand_in: StandIn,
    out: TextIO,
) -> None:
    camera = stand_in.camera
    kind = lens.kind.replace("_", " ")
    out.write(f"{name}: {lens.width}x{lens.height} px, lens {kind}\n")
    out.write(f"fx {camera.fx:.3f}  fy {camera.fy:.3f}  cx {camera.cx:.3f}  cy {camera.cy:.3f}\n")
    out.write(f"k1 k2 p1 p2 k3: {' '.join(f'{k:.6f}' for k in camera.distortion)}\n")
    if stand_in.worst_px > 0.0:
        out.write(
            f"written as a Brown-Conrady lens, which is off by at most {stand_in.worst_px:.3f} px in the image\n"
        )
    out.write(
        "\ngrade: weak\nimported: the file does not say how well its numbers are known; "
        f"{100.0 * FOCAL_SIGMA:g} % of the focal length are assumed\n"
        f"    next: `path-handoff calibrate camera` from views of a board tells\n\n"
        f"{options.out}: name it in a rig, [sender.camera] or [receiver.camera]: calibration\n"
    )
