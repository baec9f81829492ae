"""``path-handoff calibrate camera``: views, what is wrong with them, the camera, and how sure it
is.
"""

from __future__ import annotations

import asyncio
import sys
from collections import Counter
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TextIO

import numpy as np

from drivers.interfaces import PartError
from drivers.rig.calibration_file import (
    MADE_BY,
    CalibrationError,
    CameraCalibration,
    CameraTable,
    Quality,
    write_calibration,
)
from drivers.rig.parts import PartSpec, create, decode_part, part_context
from drivers.rig.unmeasured import load_for_camera
from missions.field.calibrate.board import board_of, otherwise
from missions.field.calibrate.collect import (
    Collected,
    CollectedImage,
    from_camera,
    from_images,
    from_recording,
)
from missions.field.calibrate.diagnose import what_else
from missions.ground.held import held_file
from missions.ground.options.calibrate import CalibrateCameraOptions
from missions.ground.rigs import FOLDER
from missions.ground.run_folder import REMEDY, claim_result
from missions.ground.work import Bars
from path.calibration.board import Board, BoardView
from path.calibration.fisheye import fit_fisheye
from path.calibration.intrinsics import (
    PARAMETERS,
    RADIAL,
    Intrinsics,
    NotSolvable,
    doubting,
    solve_intrinsics,
)
from path.calibration.judge import (
    BadSet,
    Grade,
    SetFault,
    SetLimits,
    coverage,
    grade_of,
    judge_solution,
    judge_views,
    sharp_enough,
    tilts_deg,
    useless,
)
from path.calibration.thinned import seen_evenly
from path.camera.thinning import Thinning
from path.messages import Role
from path.values import frozen

LIMITS = SetLimits()
LEAST_PX = 16
MOST_PX = 8191


class BadViews(CalibrationError):
    """A set of views that no calibration should be made from. ``faults`` has every reason."""

    def __init__(self, faults: Sequence[SetFault]) -> None:
        found = "\n".join(f"{fault.reason.value}: {fault.found}" for fault in faults)
        super().__init__(
            f"these views are refused\n{found}", "\n       ".join(fault.fix for fault in faults)
        )
        self.faults = tuple(faults)


@frozen(eq=False)
class Calibrated:
    """A calibration. ``looks``: of ``solution.views``, in their order; ``faults``: what keeps it
    from being good.
    """

    solution: Intrinsics
    looks: tuple[CollectedImage, ...]
    grade: Grade = "good"
    faults: tuple[SetFault, ...] = ()


def calibrate_camera(options: CalibrateCameraOptions, out: TextIO) -> int:
    """The command. Raises PartError: what was asked wrongly, or BadViews."""
    board = board_of(options)
    with held_file(options.out):
        return _calibrate_camera(options, board, out)


def _calibrate_camera(options: CalibrateCameraOptions, board: Board, out: TextIO) -> int:
    from missions.field.calibrate.picture import (  # noqa: PLC0415 (matplotlib takes a second)
        draw_calibration,
    )

    picture = options.out.with_suffix(".png")
    claim_result(options.out, MADE_BY)
    claim_result(picture, MADE_BY)
    collected, source = _collect(options, board, out)
    if not _found(collected) and not options.rig:
        other = otherwise(board)
        out.write(f"no image shows the board ({board.text}); tried as {other.text}\n")
        again, _ = _collect(options, other, out)
        if _found(again):
            board = other
            collected = again
    out.write(
        f"{_found(collected)} of {len(collected.looks)} images show the board ({board.text})\n"
    )
    try:
        done = calibrate(collected, board)
    except BadViews:
        draw_calibration(collected, None, picture)
        out.write(f"{picture}: what there is\n")
        raise
    solution = done.solution
    calibration = _file_of(done, collected, board, options.serial or collected.serial, source)
    write_calibration(options.out, calibration)
    draw_calibration(collected, solution, picture)
    _report(done, calibration, out)
    out.write(
        f"\n{options.out}: name it in a rig, [sender.camera] or [receiver.camera]: calibration\n{picture}\n"
    )
    return 0


def calibrate(collected: Collected, board: Board, limits: SetLimits = LIMITS) -> Calibrated:
    """The camera from what was collected, with a grade. Raises BadViews with all that is wrong when
    it is useless.
    """
    sizes = Counter(look.size for look in collected.looks)
    if len(sizes) > 1:
        found = ", ".join(
            f"{count} of {width}x{height} px" for (width, height), count in sizes.most_common()
        )
        raise BadViews([SetFault(BadSet.MIXED_SIZES, f"images of different sizes: {found}",
                              "put the images of one stream into a folder of their own")])  # fmt: skip
    seen = [look for look in collected.looks if look.view is not None]
    if not seen:
        found, fix = what_else(collected.others, board)
        raise BadViews([SetFault(BadSet.NO_BOARD, found, fix)])
    views = [look.view for look in seen if look.view is not None]
    sharp = sharp_enough(views, limits)
    faults: list[SetFault] = []
    blurred = [look.name for look, good in zip(seen, sharp, strict=True) if not good]
    looks = [look for look, good in zip(seen, sharp, strict=True) if good]
    views = [view for view, good in zip(views, sharp, strict=True) if good]
    size = next(iter(sizes))
    faults += judge_views(views, size, limits)
    if blurred and len(views) < limits.min_views:
        faults.append(SetFault(BadSet.BLURRED, f"{len(blurred)} views are blurred, such as {blurred[0]}",
                            "hold board and camera still, give more light or a shorter exposure"))  # fmt: skip
    if len(views) < limits.fewest_views:
        raise BadViews(faults)
    try:
        greys = [look.grey for look in looks if look.grey is not None]
        even = seen_evenly(greys, views, board) if len(greys) == len(views) else None
        views, thinning = (views, None) if even is None else even
        solution, terms = solve_as_told(views, board, size, thinning)
    except NotSolvable as error:
        fault = SetFault(
            BadSet.NOT_SOLVABLE,
            f"no camera fits these views: {error}",
            "is the board the one you named?",
        )
        raise BadViews([*faults, fault]) from error
    if (fault := _other_lens(solution, terms, views, board, thinning)) is not None:
        raise BadViews([*faults, fault])
    faults += judge_solution(solution, limits)
    if terms < RADIAL:
        faults.append(SetFault(BadSet.UNCERTAIN, f"the distortion is told by {terms} of its {RADIAL} radial terms only",
                            "bring the board into the corners of the image"))  # fmt: skip
    if faults:
        solution = doubting(solution)
    if useless(solution, limits):
        raise BadViews(faults)
    return Calibrated(solution, tuple(looks), grade_of(solution, faults, limits), tuple(faults))


def _other_lens(
    solution: Intrinsics,
    terms: int,
    views: Sequence[BoardView],
    board: Board,
    thinning: Thinning | None,
) -> SetFault | None:
    """Return the fault of views that a fisheye took; None where Brown-Conrady's lens describes
    them.
    """
    whole = (
        solution
        if terms == RADIAL
        else solve_intrinsics(views, board, solution.size, thinning=thinning)
    )
    fisheye = fit_fisheye(whole, board)
    if fisheye is None or not (fisheye.is_clear or fisheye.instead_of(solution.rms_px)):
        return None
    return SetFault(
        BadSet.OTHER_LENS,
        f"the lens is a fisheye: an equidistant one (fx {fisheye.focal_px:.0f} px) leaves {fisheye.rms_px:.3f} px "
        f"of these corners, Brown-Conrady's {solution.rms_px:.3f} px, and would have a wrong focal length",
        "take a lens of less angle, or a stream that is cropped: fisheyes are not flown with",
    )


def solve_as_told(
    views: Sequence[BoardView],
    board: Board,
    size: tuple[int, int],
    thinning: Thinning | None = None,
) -> tuple[Intrinsics, int]:
    """The camera with as many radial terms as views can tell, and how many these are. Raises
    NotSolvable.
    """
    solution = solve_intrinsics(views, board, size, thinning=thinning)
    terms = RADIAL
    while solution.camera is None and terms > 1:
        terms -= 1
        solution = solve_intrinsics(views, board, size, terms, thinning)
    return solution, terms


def _found(collected: Collected) -> int:
    return sum(look.view is not None for look in collected.looks)


def _collect(options: CalibrateCameraOptions, board: Board, out: TextIO) -> tuple[Collected, str]:
    named = [name for name in ("images", "video", "rig") if getattr(options, name)]
    if len(named) != 1:
        raise PartError(
            f"expected one of --images, --video and --rig, found {', '.join(named) or 'none'}",
            "say where the views of the board come from",
        )
    bars = Bars(sys.stderr if out is sys.stdout else out)
    if options.images is not None:
        return from_images(options.images, board, bars), str(options.images)
    if options.video is not None:
        return from_recording(options.video, board, options.views, bars), str(options.video)
    return _from_rig(options, board, out), f"{options.role} of {options.rig}"


def _from_rig(options: CalibrateCameraOptions, board: Board, out: TextIO) -> Collected:
    """Views of a rig's camera. Its calibration in the rig may be of anything: it is not used."""
    rig = load_for_camera(options.rig, [FOLDER], size_of(options.size))
    role = Role(options.role)
    _, perception = decode_part(rig.role(role).perception)
    spec = getattr(perception, "camera", None)
    if not isinstance(spec, PartSpec):
        raise PartError(
            f"{rig.role(role).perception.where}: it has no camera of its own",
            "name a rig with real cameras",
        )
    camera = create(spec, part_context(rig, role))
    folder = options.out.with_suffix("")
    if there := sorted(folder.glob("view-*.png")):
        raise PartError(f"{folder} holds {len(there)} views already: none is written over", REMEDY)
    out.write(f"show the board to the {role.value}'s camera; views are kept in {folder}\n")

    def say(line: str) -> None:
        out.write(f"{line}\n")
        out.flush()

    return asyncio.run(from_camera(camera, board, options.views, options.seconds, folder, say))


def size_of(text: str) -> tuple[int, int]:
    """Width and height of ``1280x720``. Raises PartError."""
    sides = text.split("x")
    size = [int(side) for side in sides if side.isdecimal() and len(side) <= len(str(MOST_PX))]
    if len(sides) != 2 or len(size) != 2 or not all(LEAST_PX <= side <= MOST_PX for side in size):
        raise PartError(
            f"--size {text!r} is no size of an image",
            "write it as WIDTHxHEIGHT in px, such as 1280x720",
        )
    return size[0], size[1]


def _file_of(
    done: Calibrated, collected: Collected, board: Board, serial: str, source: str
) -> CameraCalibration:
    solution = done.solution
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = solution.values
    thinning = None if solution.camera is None else solution.camera.thinning
    views = [look.view for look in collected.looks if look.view is not None]
    return CameraCalibration(
        kind="camera",
        version=1,
        made=datetime.now(UTC).isoformat(timespec="seconds"),
        serial=serial,
        source=Path(source).name or source,
        board=board.text,
        camera=CameraTable(
            *solution.size, fx, fy, cx, cy, (k1, k2, p1, p2, k3), solution.doubts, thinning
        ),
        standard_errors=dict(zip(PARAMETERS, solution.sigmas, strict=True)),
        quality=Quality(
            rms_px=round(solution.rms_px, 5),
            held_out_px=round(solution.held_out_px, 5),
            views=len(solution.views),
            corners=sum(len(view.ids) for view in solution.views),
            coverage=round(float((coverage(views, solution.size) > 0).mean()), 3),
        ),
        grade=done.grade,
        weak=tuple(fault.reason.value for fault in done.faults),
    )


def _report(done: Calibrated, calibration: CameraCalibration, out: TextIO) -> None:
    solution = done.solution
    quality = calibration.quality
    out.write(f"\n{'view':<28}{'corners':>8}{'left out':>9}{'blur px':>9}{'tilt deg':>10}{'dist m':>8}"
              f"{'rms px':>9}{'held out':>10}\n")  # fmt: skip
    tilts = tilts_deg(solution)
    for look, view, tilt in zip(done.looks, solution.views, tilts, strict=True):
        assert look.view is not None
        out.write(
            f"{look.name[:27]:<28}{len(view.ids):>8}{view.outliers:>9}{look.view.blur_px:>9.2f}"
            f"{np.hypot(*tilt):>10.0f}{view.distance_m:>8.2f}{view.rms_px:>9.3f}{view.held_out_px:>10.3f}\n"
        )
    out.write("\n")
    for name, value, sigma in zip(PARAMETERS, solution.values, solution.sigmas, strict=True):
        out.write(f"{name:<4}{value:>14.{3 if abs(value) > 10 else 6}f}  +- {sigma:.2g}\n")
    out.write(
        f"\nrms {quality.rms_px:.3f} px; of views that were left out {quality.held_out_px:.3f} px "
        f"({quality.corners} corners in {quality.views} views, {100 * quality.coverage:.0f} % of the image)\n"
    )
    out.write(f"the board's ends are {1e3 * solution.curl_m[0]:+.2f} mm (along its rows) and "
              f"{1e3 * solution.curl_m[2]:+.2f} mm (along its columns) out of its middle's plane\n")  # fmt: skip
    if calibration.camera.thinning is not None:
        thin = calibration.camera.thinning
        out.write(f"the camera leaves out pixels: {thin.kept} of {thin.of} rows and columns of its sensor are in the "
                  "image; the file says so, and poses reckon with it\n")  # fmt: skip
    out.write(f"\ngrade: {done.grade}\n")
    for fault in done.faults:
        out.write(f"{fault.reason.value}: {fault.found}\n    next: {fault.fix}\n")
