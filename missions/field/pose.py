"""``path-handoff pose``: where a printed marker is, in every frame of a recording."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TextIO

import cv2
import numpy as np

from drivers.clock import busy_ns
from drivers.interfaces import PartError
from drivers.recordings.recording import RecordedFrame, Recording
from drivers.rig.calibration_file import check_size, quaternion, read_camera
from flight.command_end import CommandEnd
from missions.field.frames import OTHER_FOLDER, open_frames, write_picture, write_table
from missions.ground.options.field import PoseOptions
from missions.ground.run_folder import claim_folder, unless_refused
from missions.ground.trajectory import write_tum
from missions.ground.work import Bars
from path.arrays import Array, Image
from path.camera.model import CameraModel
from path.geometry.transforms import Pose
from path.marker.instead import grey_of, seen_instead
from path.marker.layout import MarkerLayout, single_marker
from path.marker.locate import LocatedMarker, locate_marker
from path.marker.photometric.known import Memory
from path.marker.pose import PoseSettings
from path.observations import Missed
from path.values import frozen

POSES = "pose.csv"
TRAJECTORY = "camera.tum"
AXES_BGR = ((60, 60, 230), (60, 200, 60), (230, 120, 40))  # x red, y green, z blue
COLUMNS = (
    "frame",
    "stamp_s",
    "x_m",
    "y_m",
    "z_m",
    "qw",
    "qx",
    "qy",
    "qz",
    "x_sigma_mm",
    "y_sigma_mm",
    "z_sigma_mm",
    "turn_sigma_deg",
    "chi2",
    "ambiguity",
    "side_px",
    "why",
)

# Nothing is known of gravity in a film, so that a small marker has two poses: the likelier one is
# given, and how likely the other one is.
LIKELIER = PoseSettings(max_ambiguity=1.0)


@frozen
class Looked:
    """One frame, and what became of it. ``busy_ms``: the time of one core that it took."""

    frame: RecordedFrame
    found: LocatedMarker | Missed
    busy_ms: float


def run(options: PoseOptions, out: TextIO | None = None) -> int:
    """Carry the command out; return 0 when the marker is in any frame. Raises PartError with what
    is wrong and what to do.
    """
    stream = out or sys.stdout
    try:
        camera = read_camera(options.camera).camera.model()
        layout = single_marker(
            options.side_mm / 1000.0,
            options.side_sigma_mm / 1000.0,
            options.marker,
            options.dictionary,
        )
    except ValueError as error:
        raise PartError(str(error), "say what is printed, and measure its black frame") from error
    recording = open_frames(options.frames, options.rate_hz)
    if options.out is None:
        return _look(camera, layout, recording, None, stream)
    with unless_refused(options.out) as folder:
        claim_folder(folder, POSES, ",".join(COLUMNS[:2]))
        _write_poses(folder / POSES, ())  # whose folder it is, from now on
        return _look(camera, layout, recording, folder, stream)


def _look(
    camera: CameraModel,
    layout: MarkerLayout,
    recording: Recording,
    folder: Path | None,
    stream: TextIO,
) -> int:
    looked: list[Looked] = []
    instead: str | None = None
    previous: Pose | None = None
    memory: Memory = {}
    progress = Bars(sys.stderr if stream is sys.stdout else stream)
    with progress.bar("frames", recording.count or 0) as advance:
        for frame in recording.frames():
            image = frame.load().color
            check_size((camera.width, camera.height), image.shape[1::-1], frame.name)
            each = _located(frame, image, camera, layout, previous, memory)
            looked.append(each)
            if isinstance(each.found, LocatedMarker):
                previous = each.found.T_c_v
            elif previous is None and instead is None:
                instead = seen_instead(grey_of(image), layout)
            if folder is not None:
                _draw(folder / f"{len(looked) - 1:06d}.jpg", image, camera, layout, each.found)
            if recording.count:
                advance()
    _say(looked, instead, recording.damage, stream)
    if folder is not None:
        _write(folder, looked)
        stream.write(f"{folder}: {POSES}, {TRAJECTORY}, and every frame with the marker's axes\n")
    return CommandEnd.FAILED.exit_code if previous is None else CommandEnd.DONE.exit_code


def _located(
    frame: RecordedFrame,
    image: Image,
    camera: CameraModel,
    layout: MarkerLayout,
    previous: Pose | None,
    memory: Memory,
) -> Looked:
    begun = busy_ns()
    found = locate_marker(
        image,
        camera,
        layout,
        previous=previous,
        memory=memory,
        settings=LIKELIER,
    )
    return Looked(frame, found, (busy_ns() - begun) / 1e6)


def _say(
    looked: Sequence[Looked],
    instead: str | None,
    damage: str,
    stream: TextIO,
) -> None:
    """Tell how many frames have the marker, why others have not, and how long it took."""
    poses = [each.found for each in looked if isinstance(each.found, LocatedMarker)]
    reasons = Counter(each.found.reason.value for each in looked if isinstance(each.found, Missed))
    missed = "".join(f", {count} {reason}" for reason, count in reasons.most_common())
    stream.write(f"{len(looked)} frames, {len(poses)} with the marker{missed}\n")
    if not poses and instead is not None:
        stream.write(f"{instead}\n")
    if damage:
        stream.write(f"{damage}\n")
    if poses:
        away = [float(np.linalg.norm(each.T_c_v.t)) for each in poses]
        sigma_mm = [1000.0 * float(np.trace(each.covariance[:3, :3])) ** 0.5 for each in poses]
        unsure = sum(each.ambiguity > PoseSettings().max_ambiguity for each in poses)
        stream.write(
            f"{min(away):.2f} to {max(away):.2f} m away, sigma {np.median(sigma_mm):.1f} mm (median); "
            f"in {unsure} frames the marker may be tilted the other way\n"
        )
    # the first frame loads things, and looks everywhere
    busy_ms = [each.busy_ms for each in looked[1:] or looked]
    median, p99 = np.percentile(busy_ms, (50, 99))
    stream.write(f"{median:.1f} ms of one core a frame (median), {p99:.1f} p99\n")


def _draw(
    file: Path,
    image: Image,
    camera: CameraModel,
    layout: MarkerLayout,
    found: LocatedMarker | Missed,
) -> None:
    """Write a frame with the marker's axes, as long as its side."""
    picture = image.copy()
    if isinstance(found, LocatedMarker):
        side_m = layout.markers[0].side_m
        ends = found.T_c_v.apply(side_m * np.vstack((np.zeros(3), np.eye(3))))
        middle, *tips = camera.project(ends)
        drawn = [tip for tip in (middle, *tips) if np.all(np.isfinite(tip))]
        if len(drawn) == len(ends):
            for tip, color in zip(tips, AXES_BGR, strict=True):
                cv2.line(picture, _pixel(middle), _pixel(tip), color, 2, cv2.LINE_AA)
    else:
        cv2.putText(
            picture,
            found.reason.value,
            (10, 24),
            cv2.FONT_HERSHEY_SIMPLEX,
            0.6,
            AXES_BGR[0],
            2,
        )
    write_picture(file, picture)


def _pixel(place: Array) -> tuple[int, int]:
    return round(float(place[0])), round(float(place[1]))


def _write(folder: Path, looked: Sequence[Looked]) -> None:
    """Write the table, and the camera's trajectory in the marker's frame."""
    _write_poses(folder / POSES, looked)
    rows = []
    for each in looked:
        if isinstance(each.found, LocatedMarker):
            T_v_c = each.found.T_c_v.inverse()
            rows.append((each.frame.stamp_ns, T_v_c.t.tolist(), quaternion(T_v_c)))
    try:
        write_tum(folder / TRAJECTORY, rows)
    except OSError as error:
        what = f"cannot write {folder / TRAJECTORY}: {error.strerror}"
        raise PartError(what, OTHER_FOLDER) from error


def _write_poses(file: Path, looked: Sequence[Looked]) -> None:
    rows = [
        (each.frame.name, f"{each.frame.stamp_ns / 1e9:.6f}", *_numbers(each.found))
        for each in looked
    ]
    write_table(file, COLUMNS, rows)


def _numbers(found: LocatedMarker | Missed) -> tuple[Any, ...]:
    """Return the columns of a frame after its stamp; empty but for the reason when there is no
    pose.
    """
    if isinstance(found, Missed):
        return ("",) * (len(COLUMNS) - 3) + (found.reason.value,)
    sigmas = np.sqrt(found.covariance.diagonal())
    return (
        *(f"{each:.6f}" for each in found.T_c_v.t),
        *(f"{each:.7f}" for each in quaternion(found.T_c_v)),
        *(f"{1000.0 * each:.2f}" for each in sigmas[:3]),
        f"{np.degrees(sigmas[3:].max()):.3f}",
        f"{found.rms**2:.3f}",
        f"{found.ambiguity:.4f}",
        f"{found.side_px:.2f}",
        "",
    )
