"""The options of the commands at one drone: its role, its guard, its parts and its rig."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tyro

from missions.ground.options.words import (
    AnyRig,
    FileName,
    Live,
    LogFolder,
    OutFolder,
    RigChoice,
    RigName,
    Slow,
)
from path.bounds import Bounds
from path.values import frozen


@frozen
class RoleOptions(RigChoice):
    """One drone's side of a handoff, as in the field."""

    rig: AnyRig

    out: LogFolder = None

    console: Literal["auto", "events"] = "auto"
    """auto: a live table in a terminal, plain lines elsewhere; events: lines of JSON, for another
    program.
    """

    state: FileName = None
    """File of what the role has to know when it is started again; in --out, or else in runs, by
    default.
    """

    guard: Literal["start", "expect", "none"] = "start"
    """start: begin the guard that the rig describes beside the role, unless one answers already;
    expect: it is begun elsewhere, and nothing takes off without it; none: fly without a guard."""

    live: Live = None


@frozen
class SenderOptions(RoleOptions):
    """Fly the sender alone, as in the field: the receiver runs on the other drone."""


@frozen
class ReceiverOptions(RoleOptions):
    """Fly the receiver alone, as in the field: the sender runs on the other drone."""


@frozen
class DesignateOptions(RigChoice):
    """Tell a D1 in the air which object is meant; without a statement: answer what it asks, from
    this terminal.
    """

    rig: AnyRig

    place: tuple[float, float] | None = None
    """Where it is: north and east in m, in the mission's local frame."""

    error_m: Annotated[float, Bounds(0.01, 1000.0)] = 0.5
    """Standard deviation of the place on each axis."""

    down_m: float | None = None
    """And how high, downward, of what flies."""

    bearing_deg: Annotated[float | None, Bounds(-360.0, 360.0)] = None
    """In which direction it is, clockwise from north, as seen from --seen-from."""

    seen_from: tuple[float, float] = (0.0, 0.0)
    """North and east in m."""

    error_deg: Annotated[float, Bounds(0.01, 90.0)] = 5.0
    """Standard deviation of the direction."""

    age_s: Annotated[float, Bounds(0.0, 3600.0)] = 0.0
    """How long ago that was."""

    picture: Path | None = None
    """File for the picture of a question, where D1 has one."""


@frozen
class GuardOptions(RigChoice):
    """Watch a vehicle on a link of its own; hold and land it when its script falls silent or a
    limit stays broken.
    """

    rig: AnyRig

    role: Literal["sender", "receiver", "both"] = "both"
    """Whose vehicle; both when one computer flies both."""

    out: LogFolder = None

    while_flown: bool = False
    """End by itself once the role's program is gone and its vehicle is down."""

    console: Literal["auto", "events"] = "auto"
    """events: started by another program; ends, as soon as nothing flies, when that closes this
    one's input.
    """

    live: Live = None

    measure: bool = False
    """Fly a mission for each way a program can fail in each phase, and for another ground station's
    change of the mode; print how soon the vehicle is held, and down, and how soon its script lets
    go."""

    case: Annotated[tuple[str, ...], tyro.conf.arg(metavar="WORD"), tyro.conf.UseAppendAction] = ()
    """With --measure: only cases with this word in them, such as kill_sender or @verify; may be
    given several times.
    """


@frozen
class DoctorOptions(RigChoice):
    """Check this machine, and a rig without moving anything."""

    rig: RigName = "sitl"
    """The rig to check: its file, its parts, its ports."""

    role: Literal["none", "sender", "receiver"] = "none"
    """Test each part of this role too: open it, measure for some seconds, close it. Nothing moves,
    nothing is set.
    """

    vehicle: Literal["none", "sender", "receiver"] = "none"
    """Connect to this role's vehicle as well, and compare its parameters with the rig's. Nothing
    moves.
    """

    other: Annotated[str | None, tyro.conf.arg(metavar="NAME|FILE")] = None
    """The other drone's rig file, where it is at hand: what both drones must have alike is compared
    with it.
    """

    rehearse: bool = False
    """Go through the tests of both roles' parts against stand-ins, in under a minute: what it will ask
    for, before there is hardware.
    """

    slow: Slow = None
    """With --role: what this computer would hold if each role had this share of one core
    (docs/compute.md).
    """

    set_parameters: bool = False
    """Set the vehicle's parameters to what the rig wants; what they were is kept in
    runs/parameters.
    """


@frozen
class PrepareOptions(RigChoice):
    """Compile the kernels of a rig now: for images, for services, and before the first flight of a
    day.
    """

    rig: AnyRig = "sitl"


@frozen
class RigsOptions:
    """List the rigs that come with PATH; write one of your own, or check it."""

    check: Annotated[str | None, tyro.conf.arg(metavar="NAME|FILE")] = None
    """Check everything in this rig that can be checked without touching hardware, as before a
    flight.
    """

    show: Annotated[str | None, tyro.conf.arg(metavar="NAME|FILE")] = None
    """Write this rig whole, with everything of the rigs that it is like: what to copy from."""

    new: Annotated[str | None, tyro.conf.arg(metavar="FILE")] = None
    """Write a commented rig for the field into this file, and the key of its link beside it."""

    autopilot: Literal["px4", "ardupilot"] = "px4"
    """With --new: what flies both drones."""

    camera: Literal["realsense"] = "realsense"
    """With --new: what both drones see with."""


@frozen
class PlanOptions(RigChoice):
    """Show what follows from what a rig measured: heights, distances, times, what limits them, what
    to expect.
    """

    rig: Annotated[AnyRig, tyro.conf.Positional] = "sim"

    out: OutFolder = None
    """Folder for plan.png, both drones and the target to scale, and plan.json; nothing is written
    by default.
    """


@frozen
class ChecklistOptions(RigChoice):
    """Write one page of paper that a rig's crew does and ticks in the field; or tick a first flight."""

    rig: Annotated[AnyRig, tyro.conf.Positional]

    out: FileName = None
    """The page, HTML that prints on one sheet of A4; RIG.checklist.html by default."""

    tick: (
        Literal[
            "doctor-d1", "doctor-d2", "switches", "blocks", "by-hand", "guard", "one-drone", "one-target", "two-drones",
            "hand-over",
        ]
        | None
    ) = None  # fmt: skip
    """Keep that this step of the first flights was done (docs/field.md), and say what is left."""

    note: str = ""
    """With --tick: what was seen."""


@frozen
class DetectOptions(RigChoice):
    """Try a detector on a recording: what it finds, and how long it takes."""

    frames: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE|DIR")]
    """Video file, folder of images, or .mcap log."""

    rig: RigName = "sitl"
    """Rig whose detector is tried, unless --model names one."""

    role: Literal["sender", "receiver"] = "sender"
    """Whose detector of the rig."""

    model: FileName = None
    """Model of the YOLOX family (ONNX), instead of the rig's detector."""

    classes: tuple[str, ...] = ()
    """Classes to look for with --model, such as `car truck`; everything by default."""

    min_score: Annotated[float, Bounds(0.0, 1.0, "of 1")] = 0.3
    """With --model: what scores less is not found."""

    rate_hz: Annotated[float | None, Bounds(0.1, 1000.0, "Hz")] = None
    """Pictures a second of a bare video stream (.h264), which does not say; of images without
    stamps, 30 by default.
    """

    measure: Annotated[Path | None, tyro.conf.arg(metavar="FILE|DIR")] = None
    """Labels of the pictures, to measure the detector on them by size and light: COCO's JSON, or a
    folder of YOLO's or VisDrone's text files, one a picture.
    """

    labels: tuple[str, ...] = ()
    """With --measure: the labels' classes that count, by their names there; everything by default."""

    regions: bool = False
    """With --measure: each object in a search region of its own, as D2 looks, instead of the whole
    picture.
    """

    out: OutFolder = None
    """Folder for boxes.csv, for the frames with their boxes drawn, and for measured.json; nothing is
    written by default.
    """


@frozen
class PoseOptions:
    """Find a printed marker in every frame of a recording: where it is, and how sure that is."""

    frames: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE|DIR")]
    """Video file, folder of images, or .mcap log."""

    camera: Annotated[Path, tyro.conf.arg(metavar="FILE")]
    """The camera's calibration, as made by `path-handoff calibrate camera`."""

    side_mm: Annotated[float, Bounds(5.0, 2000.0, "mm")]
    """Side of the black frame, as measured on the print."""

    side_sigma_mm: Annotated[float, Bounds(0.0, 50.0, "mm")] = 0.2
    """How well the side is known."""

    marker: Annotated[int, Bounds(0, 2319, "(an id)")] = 0
    """The marker's id."""

    dictionary: str = "DICT_4X4_50"
    """OpenCV's dictionary of the marker; DICT_APRILTAG_36h11 for AprilTags, which are turned by
    180 degrees there.
    """

    rate_hz: Annotated[float | None, Bounds(0.1, 1000.0, "Hz")] = None
    """Pictures a second of a bare video stream (.h264), which does not say; of images without
    stamps, 30 by default.
    """

    out: OutFolder = None
    """Folder for pose.csv, camera.tum and the frames with the marker's axes drawn; nothing is
    written by default.
    """
