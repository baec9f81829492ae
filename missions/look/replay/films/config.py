"""The file that names two films, what is known of them, and the rig whose method looks at them."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from dataclasses import field, replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated

from drivers.interfaces import PartError
from drivers.recordings.recording import (
    RecordedFrame,
    Recording,
    RecordingError,
    RecordingOptions,
    open_recording,
)
from drivers.rig.calibration_file import check_size, read_camera
from drivers.rig.parts import Rig, RoleRig
from drivers.rig.tables import RigError, decode_table, read_toml
from missions.ground import rig_library
from missions.look.replay.films.trajectory import FlownPath, read_flown_path
from path.bounds import Bounds
from path.messages import Role
from path.values import frozen

NS = 1_000_000_000
HANGING_SIGMA_DEG = 3.0
REMEDY = "correct the file (docs/films.md)"


@frozen
class FilmTable:
    """One drone's recording.

    Attributes:
        film: a video file, a folder of images, or frames that PATH recorded (docs/cameras.md).
        calibration: of the camera, as `path-handoff calibrate camera` writes it.
        stamps, depth, rate_hz, topic: as in ``drivers.recordings.recording.RecordingOptions``.
        depth_unit_mm: of one step of the depth images.
        offset_s: what is added to its stamps, and its trajectory's, so that both drones are on one
            clock.
        trajectory: where the drone was (TUM: seconds, x y z, quaternion x y z w; body to
            north-east-down); without it the drone is taken to hang level in one place.
    """

    film: Path
    calibration: Path
    stamps: Path | None = None
    depth: Path | None = None
    depth_unit_mm: Annotated[float, Bounds(0.001, 1000.0, "mm")] = 1.0
    rate_hz: Annotated[float | None, Bounds(0.1, 1000.0)] = None
    topic: str = ""
    offset_s: Annotated[float, Bounds(-1e10, 1e10)] = 0.0
    trajectory: Path | None = None


@frozen
class TargetPick:
    """The target in D1's film: what is at a pixel, ``at_s`` after both films run; None: the only
    object there is.
    """

    pixel: Annotated[tuple[float, float], Bounds(-0.5, 16384.0, "px")] | None = None
    at_s: Annotated[float, Bounds(0.0, 1e6)] = 0.0


@frozen
class FilmsTable:
    """The whole file.

    Attributes:
        rig: a rig's name, or a file beside this one: marker, mounts, method, mission, and the
            perception's detector.
        link_s: from the instant of a frame until what it gave is at the other drone.
        begin_s, end_s: the part to look at, from when both films run; None: to where one ends.
        attitude_sigma_deg: how well roll and pitch of both are known, one standard deviation; None:
            as the rig says with two trajectories, and ``HANGING_SIGMA_DEG`` for drones that are
            taken to hang level.
    """

    rig: str
    sender: FilmTable
    receiver: FilmTable
    target: TargetPick = field(default_factory=TargetPick)
    link_s: Annotated[float, Bounds(0.0, 0.4)] = 0.05
    begin_s: Annotated[float, Bounds(0.0, 1e6)] = 0.0
    end_s: Annotated[float | None, Bounds(0.0, 1e6, above=True)] = None
    attitude_sigma_deg: Annotated[float | None, Bounds(0.01, 20.0)] = None


@frozen
class PlayedFilm:
    """A film that can be played. ``offset_ns``: from its stamps to the clock of both."""

    file: Path
    recording: Recording
    offset_ns: int
    span_ns: tuple[int, int]
    flown: FlownPath | None
    depth_unit_mm: float = 1.0

    def frames(self, begin_ns: int, end_ns: int) -> Iterator[tuple[int, RecordedFrame]]:
        """Those within a part of the common clock, with their stamps on it; one that is no newer is
        left out.
        """
        newest_ns = begin_ns - 1
        for frame in self.recording.frames():
            stamp_ns = frame.stamp_ns + self.offset_ns
            if newest_ns < stamp_ns <= end_ns:
                newest_ns = stamp_ns
                yield stamp_ns, frame


@frozen
class Films:
    """Two films on one clock, and the rig with the cameras that filmed.

    ``begin_ns``, ``end_ns``: the part that is looked at. ``target_ns``: when the target is picked.
    """

    rig: Rig
    sender: PlayedFilm
    receiver: PlayedFilm
    target: TargetPick
    target_ns: int
    link_ns: int
    begin_ns: int
    end_ns: int

    def of(self, role: Role) -> PlayedFilm:
        return self.sender if role is Role.SENDER else self.receiver


def read_films(file: Path) -> Films:
    """Raise PartError naming what is missing or cannot be: keys, files, sizes, stamps that do not
    overlap.
    """
    try:
        table = decode_table(read_toml(file), FilmsTable, file.name, file.parent)
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise PartError(f"{file}: {getattr(error, 'strerror', None) or error}", REMEDY) from error
    except RigError as error:
        raise PartError(str(error), REMEDY) from error
    beside = file.parent / table.rig
    rig = rig_library.load_unchecked(str(beside) if beside.is_file() else table.rig)
    rig = replace(
        rig,
        sender=_filmed(rig.sender, table.sender),
        receiver=_filmed(rig.receiver, table.receiver),
    )
    known = table.sender.trajectory is not None and table.receiver.trajectory is not None
    sigma_deg = table.attitude_sigma_deg or (None if known else HANGING_SIGMA_DEG)
    if sigma_deg is not None:
        rig = replace(rig, mission={**rig.mission, "attitude_sigma_deg": sigma_deg})
    sender = _film(table.sender, rig.sender, True)
    receiver = _film(table.receiver, rig.receiver, False)
    both_ns, over_ns = (
        pick(a, b) for pick, a, b in zip((max, min), sender.span_ns, receiver.span_ns, strict=True)
    )
    if over_ns <= both_ns:
        spans = "; ".join(f"{each.file.name} {_span(each)}" for each in (sender, receiver))
        raise PartError(
            f"{file.name}: the films do not overlap on one clock: {spans}",
            "set offset_s of one of them",
        )
    begin_ns = both_ns + round(table.begin_s * NS)
    end_ns = over_ns if table.end_s is None else min(over_ns, both_ns + round(table.end_s * NS))
    if end_ns <= begin_ns:
        raise PartError(
            f"{file.name}: nothing is left between begin_s and end_s: both run for {(over_ns - both_ns) / NS:.2f} s",
            "take an earlier begin_s, or a later end_s",
        )
    for each in (sender, receiver):
        if each.flown is not None and not each.flown.covers(begin_ns, end_ns):
            raise PartError(
                f"{file.name}: the trajectory of {each.file.name} goes from {each.flown.span}, and the films "
                f"from {begin_ns / NS:.3f} s to {end_ns / NS:.3f} s",
                "record it for as long as the film, or narrow begin_s and end_s",
            )
    target_ns = max(begin_ns, both_ns + round(table.target.at_s * NS))
    if target_ns >= end_ns:
        raise PartError(
            f"{file.name}: target.at_s = {table.target.at_s:g} is after the end",
            "take an earlier one",
        )
    return Films(
        rig,
        sender,
        receiver,
        table.target,
        target_ns,
        round(table.link_s * NS),
        begin_ns,
        end_ns,
    )


def _filmed(own: RoleRig, table: FilmTable) -> RoleRig:
    """A role of the rig with the camera that filmed. Raises CalibrationError."""
    calibration = read_camera(table.calibration)
    try:
        model = calibration.camera.model()
    except ValueError as error:
        raise PartError(f"{table.calibration}: {error}", REMEDY) from error
    return replace(own, camera=model)


def _film(
    table: FilmTable,
    own: RoleRig,
    own_is_sender: bool,
) -> PlayedFilm:
    options = RecordingOptions(table.rate_hz, table.stamps, table.depth, table.topic)
    recording = open_recording(table.film, options)
    offset_ns = round(table.offset_s * NS)
    frames = list(recording.frames())
    first = frames[0].load()
    if own_is_sender and first.depth_mm is None and "target" not in own.perception.options:
        raise PartError(
            f"{table.film}: there is no depth with it, and the rig's perception is told no size of the target",
            "name the depth images with depth, or a rig with [sender.perception.target] (docs/targets.md)",
        )
    color = first.color
    size = own.camera.width, own.camera.height
    check_size(size, (color.shape[1], color.shape[0]), f"{table.film} by {table.calibration.name}")
    stamps = [frame.stamp_ns for frame in frames]
    for number, (before, stamp_ns) in enumerate(pairwise(stamps), 1):
        if stamp_ns < before:
            raise RecordingError(
                f"{table.film}: {frames[number].name} is older than the frame before",
                "correct the stamps",
            )
    flown = None if table.trajectory is None else read_flown_path(table.trajectory, offset_ns)
    return PlayedFilm(
        table.film,
        recording,
        offset_ns,
        (stamps[0] + offset_ns, stamps[-1] + offset_ns),
        flown,
        table.depth_unit_mm,
    )


def _span(film: PlayedFilm) -> str:
    first, last = film.span_ns
    return f"from {first / NS:.3f} s to {last / NS:.3f} s"
