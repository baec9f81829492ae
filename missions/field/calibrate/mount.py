"""``path-handoff calibrate mount``: where D1's camera is, seen from its marker."""

from __future__ import annotations

import math
import sys
import tomllib
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, TextIO

import cv2
import numpy as np

from drivers.interfaces import PartError
from drivers.recordings.recording import read_image
from drivers.rig.calibration_file import (
    MADE_BY,
    CalibrationError,
    MarkerPrint,
    MountCalibration,
    check_size,
    quaternion,
    read_camera,
    write_calibration,
)
from drivers.rig.mounts import CameraMount, MarkerMount
from drivers.rig.parts import Rig
from drivers.rig.tables import RigError, decode_table, read_toml
from drivers.rig.unmeasured import load_for_mount
from missions.field.calibrate.board import board_of
from missions.field.calibrate.collect import image_files
from missions.ground.held import held_file
from missions.ground.options.calibrate import CalibrateMountOptions
from missions.ground.rigs import FOLDER
from missions.ground.run_folder import claim_result
from missions.ground.work import Bars
from path.bounds import Bounds
from path.calibration.board import Board, find_board
from path.calibration.intrinsics import NotSolvable
from path.calibration.mount import MountPair, MountSolution, solve_mount
from path.camera.model import CameraModel
from path.geometry.rotation import R_from_quat, angle_between
from path.geometry.transforms import Pose
from path.marker.detect import detect_markers
from path.marker.turned import OFFICIAL
from path.values import frozen

FEWEST_PAIRS = 5
MOST_POSITION_SIGMA_M = 0.003
MOST_ROTATION_SIGMA_DEG = 0.5
# chi-square per number: of a pair that is left out, and of the whole that is refused
MOST_MISFIT = 16.0
TURNED_DEG = 20.0  # from the mounts in the rig, that nobody means
MOST_LEFT_OUT = 0.25  # of the pairs
SIDE_SIGMAS = 4.0


@frozen
class MeasuredSigma:
    """The accuracy of a tape measure and a protractor, one standard deviation per axis."""

    position_m: Annotated[float, Bounds(0.0, 1.0, above=True)]
    angle_deg: Annotated[float, Bounds(0.0, 90.0, above=True)]


@frozen
class MeasuredMount:
    """The file of ``--measured``: where camera and marker sit on D1's body, as in a rig."""

    camera: CameraMount
    marker: MarkerMount
    sigma: MeasuredSigma


def calibrate_mount(options: CalibrateMountOptions, out: TextIO) -> int:
    """The command. Raises PartError with what is wrong and what to do."""
    if not options.rig:
        raise PartError("--rig is missing", "name the rig that has the markers and D1's camera")
    with held_file(options.out):
        claim_result(options.out, MADE_BY)
        return _calibrate_mount(options, out)


def _calibrate_mount(options: CalibrateMountOptions, out: TextIO) -> int:
    rig, hangs = load_for_mount(options.rig, [FOLDER])
    calibration = (
        _from_tape(options.measured, rig) if options.measured else _from_views(options, rig, out)
    )
    write_calibration(options.out, calibration)
    _report(calibration, out)
    if hangs:
        out.write(_turned(calibration, rig))
    out.write(
        f'\n{options.out}: name it in the rig: [sender.mount.marker] calibration = "{options.out.name}"\n'
    )
    position_m, angle_deg = calibration.largest_sigmas
    if position_m > rig.method.mount_sigma_m or angle_deg > rig.method.mount_sigma_deg:
        out.write(
            f"and in its [method]: mount_sigma_m = {_up(position_m):g}, mount_sigma_deg = {_up(angle_deg):g}\n"
        )
    return 0


def _turned(calibration: MountCalibration, rig: Rig) -> str:
    """What to say of a marker that hangs far from how the rig has it: most such plates are the
    wrong way up.
    """
    turned_deg = math.degrees(
        angle_between(R_from_quat(calibration.q_v_c), rig.sender.mount.T_v_c.R)
    )
    if turned_deg < TURNED_DEG:
        return ""
    official = f" {OFFICIAL}." if "APRILTAG" in rig.layout.dictionary else ""
    return (
        f"\nnote: that is turned by {turned_deg:.0f} degrees against the mounts in the rig. Is the plate the right way "
        f"up?{official} If it stays as it is, this calibration holds; else turn it and calibrate again.\n"
    )


def _up(value: float) -> float:
    """Two digits, rounded up."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return math.ceil(value / unit) * unit


def _from_tape(file: Path, rig: Rig) -> MountCalibration:
    """``T_v_c1`` from places measured on the body. The errors of both ends add up."""
    try:
        measured = decode_table(read_toml(file), MeasuredMount, file.name, file.parent)
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise CalibrationError(
            f"{file}: {error}", "docs/calibration.md describes the file"
        ) from error
    except RigError as error:
        raise CalibrationError(str(error), "docs/calibration.md describes the file") from error
    T_v_c = measured.marker.pose().inverse() @ measured.camera.pose()
    angle = math.radians(measured.sigma.angle_deg)
    # the camera's place in v turns with the marker's angle
    lever = angle * float(np.linalg.norm(T_v_c.t))
    position = math.sqrt(2.0 * measured.sigma.position_m**2 + lever**2)
    degrees = math.sqrt(2.0) * measured.sigma.angle_deg
    sigmas = (position, position, position), (degrees, degrees, degrees)
    return _file_of(rig, T_v_c, *sigmas, f"tape measure: {file.name}")


def _from_views(
    options: CalibrateMountOptions,
    rig: Rig,
    out: TextIO,
) -> MountCalibration:
    board = board_of(options)
    _check_board(board, rig)
    if options.images is None or options.other_images is None or options.other_camera is None:
        raise PartError(
            "expected --images, --other-images and --other-camera, or --measured",
            "pairs of images of the same names, and the calibration of the other camera",
        )
    other = read_camera(options.other_camera)
    pairs, missing = _pairs(
        options.images,
        options.other_images,
        rig,
        other.camera.model(),
        board,
        out,
    )
    out.write(f"{len(pairs)} pairs show the board twice and the marker\n")
    for name, what in missing:
        out.write(f"left out {name}: {what}\n")
    solution = solve_pairs(pairs, rig, other.camera.model(), board)
    for pair in solution.pairs:
        out.write(f"{pair.name:<28} marker rms {pair.rms_px:.3f} px, misfit {pair.misfit:.1f}\n")
    for name in sorted({pair.name for pair in pairs} - {fit.name for fit in solution.pairs}):
        out.write(f"left out {name}: it does not fit the others\n")
    sigma = np.sqrt(solution.covariance.diagonal())
    x, y, z = (float(s) for s in sigma[:3])
    rx, ry, rz = (math.degrees(s) for s in sigma[3:])
    rms = math.sqrt(sum(pair.rms_px**2 for pair in solution.pairs) / len(solution.pairs))
    return _file_of(
        rig,
        solution.T_v_c1,
        (x, y, z),
        (rx, ry, rz),
        options.images.name,
        len(solution.pairs),
        rms,
    )


def _check_board(board: Board, rig: Rig) -> None:
    if board.pattern != "charuco":
        raise PartError(
            "a chessboard looks the same when it is turned by half a turn",
            "use --board charuco for a mount",
        )
    shared = [m.id for m in rig.layout.markers if m.id < board.columns * board.rows // 2]
    if board.dictionary == rig.layout.dictionary and shared:
        raise PartError(
            f"the board has the marker {shared[0]} of {board.dictionary} too, which D1 carries",
            "print a board of another dictionary: `path-handoff calibrate board --dictionary DICT_5X5_100`",
        )


def _pairs(
    first: Path,
    other: Path,
    rig: Rig,
    camera_3: CameraModel,
    board: Board,
    out: TextIO,
) -> tuple[list[MountPair], list[tuple[str, str]]]:
    """Usable pairs, and the names of the others with what they lack. Raises CalibrationError for a
    wrong size.
    """
    others = {file.stem: file for file in image_files(other)}
    files = [file for file in image_files(first) if file.stem in others]
    if not files:
        raise PartError(
            f"{first} and {other} have no image of the same name",
            "name both images of a moment alike",
        )
    pairs: list[MountPair] = []
    missing: list[tuple[str, str]] = []
    camera_1 = rig.sender.camera
    with Bars(sys.stderr if out is sys.stdout else out).bar("pairs", len(files)) as advance:
        for file in files:
            color_1 = read_image(file)
            color_3 = read_image(others[file.stem])
            check_size(
                (camera_1.width, camera_1.height),
                (color_1.shape[1], color_1.shape[0]),
                str(file),
            )
            check_size(
                (camera_3.width, camera_3.height),
                (color_3.shape[1], color_3.shape[0]),
                str(others[file.stem]),
            )
            grey_1, grey_3 = (
                np.asarray(cv2.cvtColor(c, cv2.COLOR_BGR2GRAY), np.uint8)
                for c in (color_1, color_3)
            )
            board_1 = find_board(grey_1, board)
            board_3 = find_board(grey_3, board)
            markers = detect_markers(color_3, None, rig.layout, camera_3)
            twice = len({m.marker_id for m in markers}) < len(markers)
            if board_1 is None or board_3 is None or not markers or twice:
                what = "a marker is there twice" if twice else "no marker in the other camera"
                what = "no board in the other camera" if board_3 is None else what
                missing.append((file.name, "no board in D1's camera" if board_1 is None else what))
            else:
                pairs.append(MountPair(file.name, board_1, board_3, tuple(markers)))
            advance()
    return pairs, missing


def solve_pairs(
    pairs: list[MountPair],
    rig: Rig,
    camera_3: CameraModel,
    board: Board,
) -> MountSolution:
    """Solve; pairs that do not fit the others are left out, the worst first. Raises
    CalibrationError.
    """
    solution = _solve(pairs, rig, camera_3, board)
    kept = pairs
    while len(pairs) - len(kept) < int(MOST_LEFT_OUT * len(pairs)):
        worst = max(solution.pairs, key=lambda fit: fit.misfit)
        if worst.misfit <= MOST_MISFIT or len(kept) <= FEWEST_PAIRS:
            break
        kept = [pair for pair in kept if pair.name != worst.name]
        solution = _solve(kept, rig, camera_3, board)
    sigma = np.sqrt(solution.covariance.diagonal())
    position_m = float(sigma[:3].max())
    rotation_deg = math.degrees(float(sigma[3:].max()))
    if solution.misfit > MOST_MISFIT:
        raise CalibrationError(
            f"the pairs contradict each other: what is left is {math.sqrt(solution.misfit):.1f} times the noise",
            "nothing may move between the two images of a pair; are they paired rightly, and both calibrations good?",
        )
    off = abs(solution.side_scale - 1.0)
    tolerance = max(marker.side_sigma_m / marker.side_m for marker in rig.layout.markers)
    if off > SIDE_SIGMAS * math.hypot(solution.side_scale_sigma, tolerance):
        raise CalibrationError(
            f"the marker measures {solution.side_scale:.4f} times what the rig says "
            f"(+- {solution.side_scale_sigma:.4f})",
            "measure the black frame again, and the squares of the board; correct side_m in the rig or --square-m",
        )
    if not (position_m <= MOST_POSITION_SIGMA_M and rotation_deg <= MOST_ROTATION_SIGMA_DEG):
        raise CalibrationError(
            f"the mount is known to {1000.0 * position_m:.1f} mm and {rotation_deg:.2f} deg, "
            f"{1000.0 * MOST_POSITION_SIGMA_M:g} mm and {MOST_ROTATION_SIGMA_DEG:g} deg are needed",
            "take more pairs, the marker large in the other camera, seen from different sides and at a slant",
        )
    return solution


def _solve(
    pairs: list[MountPair],
    rig: Rig,
    camera_3: CameraModel,
    board: Board,
) -> MountSolution:
    if len(pairs) < FEWEST_PAIRS:
        raise CalibrationError(
            f"{len(pairs)} usable pairs, at least {FEWEST_PAIRS} are needed",
            "take more: some 10 to 15, the drone seen from another side in each",
        )
    try:
        return solve_mount(pairs, rig.sender.camera, camera_3, board, rig.layout)
    except (NotSolvable, np.linalg.LinAlgError) as error:
        raise CalibrationError(
            f"no mount fits these pairs: {error}", "are both calibrations of these cameras?"
        ) from error


def _file_of(
    rig: Rig,
    T_v_c: Pose,
    position_sigma_m: tuple[float, float, float],
    rotation_sigma_deg: tuple[float, float, float],
    source: str,
    pairs: int = 0,
    rms_px: float = 0.0,
) -> MountCalibration:
    x, y, z = (float(v) for v in T_v_c.t)
    return MountCalibration(
        kind="mount",
        version=1,
        made=datetime.now(UTC).isoformat(timespec="seconds"),
        serial=rig.sender.camera_serial,
        source=source,
        markers=tuple(MarkerPrint(m.id, m.side_m) for m in rig.layout.markers),
        position_v_m=(x, y, z),
        q_v_c=quaternion(T_v_c),
        position_sigma_m=position_sigma_m,
        rotation_sigma_deg=rotation_sigma_deg,
        pairs=pairs,
        rms_px=round(rms_px, 4),
    )


def _report(calibration: MountCalibration, out: TextIO) -> None:
    out.write("\nT_v_c1, the camera seen from the marker:\n")
    for axis, value, sigma in zip(
        "xyz",
        calibration.position_v_m,
        calibration.position_sigma_m,
        strict=True,
    ):
        out.write(f"  {axis} {1000.0 * value:9.2f} mm +- {1000.0 * sigma:.2f}\n")
    q = ", ".join(f"{v:.6f}" for v in calibration.q_v_c)
    sigmas = ", ".join(f"{sigma:.3f}" for sigma in calibration.rotation_sigma_deg)
    out.write(f"  q (wxyz) {q}, +- {sigmas} deg about x, y, z of the marker\n")
