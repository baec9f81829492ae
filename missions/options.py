"""The options of the commands. The command line is generated from these, and so is its help."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from path.bounds import Bounds

Seed = Annotated[int, Bounds(0, 2**32 - 1, "(a seed)")]
Jobs = Annotated[int, Bounds(0, 1024, "processes")]
RigName = Annotated[str, tyro.conf.arg(metavar="NAME|FILE")]
LevelName = Literal["none", "lossy", "harsh", "hostile"]
OutFolder = Annotated[Path | None, tyro.conf.arg(metavar="DIR")]
FileName = Annotated[Path | None, tyro.conf.arg(metavar="FILE")]
TrialName = Literal[
    "all",
    "sensitivity",
    "static",
    "corners",
    "calibration",
    "dynamic",
    "ambiguity",
    "handshake",
    "evidence",
    "recall",
    "thresholds",
    "link",
    "compute",
    "processes",
    "rendezvous",
    "beacon",
    "soak",
    "real",
]
Live = Annotated[str | None, tyro.conf.arg(metavar="HOST:PORT")]
Slow = Annotated[float | None, Bounds(0.02, 1.0, "of a core")]
Errors = Literal["exact", "careful", "careless"] | None
Faults = Annotated[
    tuple[str, ...], tyro.conf.arg(name="fault", metavar="NAME[=VALUE][@MOMENT[+SECONDS]]"), tyro.conf.UseAppendAction
]


LegFaults = Annotated[
    tuple[str, ...],
    tyro.conf.arg(name="fault", metavar="[LEG:]NAME[=VALUE][@MOMENT[+SECONDS]]"),
    tyro.conf.UseAppendAction,
]


@dataclass(frozen=True, slots=True)
class HandoffOptions:
    """Fly a whole handoff: both drones, and the world when the rig has a simulated one."""

    rig: RigName = "sitl"
    """A rig by name (see `path-handoff rigs`), or a rig's TOML file."""

    seed: Seed = 0
    """Seed of the world and of every noise: the same seed is the same run at the sim levels."""

    seeds: Annotated[int, Bounds(1, 1_000_000, "runs")] = 1
    """Fly this many runs with seeds from --seed on, and print what became of them."""

    jobs: Jobs = 0
    """Runs at a time with --seeds; 0: one per core. Rigs in real time fly one at a time."""

    fault: Faults = ()
    """Faults to try, such as lookalike, link_loss=0.3 or kill_sender=1@verify+2; may be given several times."""

    errors: Errors = None
    """Errors of the simulated world against the rig (docs/errors.md): as a careful crew leaves it, three times
    that, or not at all; careful unless the rig says otherwise."""

    out: OutFolder = None
    """Folder for logs, summary and picture; runs/<time> by default."""

    junit: FileName = None
    """With --seeds: write a JUnit file too, a test case a run, failed unless it committed."""

    slow: Slow = None
    """At `sitl`: confine each role's program to this share of one core, 0.2 for a fifth, by a control group
    (docs/compute.md)."""

    picture: bool = True
    """Draw run.png at the end."""

    live: Live = None
    """Serve what is logged, as it is logged, to Foxglove, Lichtblick and `path-handoff view`: 127.0.0.1:8765 when no
    address is given. Other hosts than this one need a token (docs/view.md)."""

    gcs: Live = None
    """At `sitl`: let a ground station watch both vehicles, QGroundControl or MAVProxy, at this address; 127.0.0.1:14550
    when none is given. A mode that it selects is a pilot's word (docs/ground-station.md)."""

    px4: FileName = None
    """PX4's SITL binary (bin/px4 in its build folder), for the rigs that fly it; PATH_PX4 names it too."""

    ardupilot: FileName = None
    """ArduCopter's SITL binary, for the rigs that fly it; PATH_ARDUPILOT names it too."""


@dataclass(frozen=True, slots=True)
class RelayOptions:
    """Hand one target from drone to drone as batteries run down: hours in simulated time, or minutes in real time."""

    rig: RigName = "relay-sim"
    """A rig with a [relay] table: its drones, their homes and batteries (docs/relay.md). relay-sim: simulated, as
    fast as it computes; relay-sitl: in real time, each drone's program a process of its own."""

    drones: Annotated[int, Bounds(2, 100, "drones")] = 3
    """The number of the rig's drones that take part, from its first one on."""

    hours: Annotated[float | None, Bounds(0.0, 1000.0, above=True)] = None
    """For how long; then the responsible drone comes home. By default as the rig says: 8 h in relay-sim, minutes in
    relay-sitl."""

    seed: Seed = 0
    """Seed of the world and of every noise: in simulated time the same seed is the same relay."""

    fault: LegFaults = ()
    """Faults to try: in every leg, such as link_loss=0.3, or in one, such as 3:kill_receiver@approach; may be
    given several times."""

    out: OutFolder = None
    """Folder for logs, summary and picture; runs/<time> by default."""

    errors: Errors = None
    """Errors of the simulated world against the rig (docs/errors.md); careful unless the rig says otherwise."""

    logs: bool = False
    """Log everything, frame by frame, and not only what is decided: some 40 MB an hour."""

    live: Live = None
    """Serve what is logged, as it is logged, to Foxglove, Lichtblick and `path-handoff view`: 127.0.0.1:8765 when no
    address is given. Other hosts than this one need a token (docs/view.md)."""

    picture: bool = True
    """Draw relay.png at the end."""


@dataclass(frozen=True, slots=True)
class TeamOptions:
    """Keep many targets observed by many drones for hours, which relieve each other as batteries run down."""

    rig: RigName = "team-sim"
    """A rig with [team], [[drones]] and [[targets]] (docs/team.md)."""

    drones: Annotated[int | None, Bounds(2, 1000, "drones")] = None
    """The number of drones; those of the rig by default, and a field laid out like it for more than it names."""

    targets: Annotated[int | None, Bounds(1, 1000, "targets")] = None
    """The number of targets; those of the rig by default, and a field laid out like it for more than it names."""

    hours: Annotated[float | None, Bounds(0.0, 1000.0, above=True)] = None
    """For how long; then everybody comes home. By default as the rig says: 2 h in team-sim."""

    seed: Seed = 0
    """Seed of the world and of every noise: in simulated time the same seed is the same flight of the team."""

    fault: LegFaults = ()
    """Faults to try: in every leg, such as link_loss=0.3, or in one, such as 3:kill_receiver@approach; may be
    given several times."""

    out: OutFolder = None
    """Folder for logs, summary and picture; runs/<time> by default."""

    errors: Errors = None
    """Errors of the simulated world against the rig (docs/errors.md); careful unless the rig says otherwise."""

    logs: bool = False
    """Log everything, frame by frame, and not only what is decided: some 40 MB an hour and drone."""

    picture: bool = True
    """Draw team.png at the end."""


@dataclass(frozen=True, slots=True)
class RoleOptions:
    """One drone's side of a handoff, as in the field."""

    rig: RigName
    """A rig by name (see `path-handoff rigs`), or a rig's TOML file."""

    out: OutFolder = None
    """Folder for the log; runs/<time> by default."""

    console: Literal["auto", "events"] = "auto"
    """auto: a live table in a terminal, plain lines elsewhere; events: lines of JSON, for another program."""

    state: FileName = None
    """File of what the role has to know when it is started again; in --out, or else in runs, by default."""

    guard: Literal["start", "expect", "none"] = "start"
    """start: begin the guard that the rig describes beside the role, unless one answers already; expect: it is begun
    elsewhere, and nothing takes off without it; none: fly without a guard."""

    live: Live = None
    """Serve what is logged, as it is logged, to Foxglove, Lichtblick and `path-handoff view`: 127.0.0.1:8765 when no
    address is given. Other hosts than this one need a token (docs/view.md)."""


@dataclass(frozen=True, slots=True)
class FlyOptions:
    """Fly a mission of your own: both drones, and the world when the rig has a simulated one."""

    mission: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MISSION.py")]
    """The mission's file (docs/own-missions.md)."""

    rig: RigName = "sim"
    """A rig by name (see `path-handoff rigs`), or a rig's TOML file."""

    seed: Seed = 0
    """Seed of the world and of every noise: the same seed is the same run at the sim levels."""

    fault: Faults = ()
    """Faults to try, such as link_loss=0.3 or kill_sender@mission+5; may be given several times."""

    errors: Errors = None
    """Errors of the simulated world against the rig (docs/errors.md); careful unless the rig says otherwise."""

    out: OutFolder = None
    """Folder for logs and summary; runs/<time> by default."""

    drone: Literal["both", "sender", "receiver"] = "both"
    """Fly this drone of the rig alone, as in the field: the other one is flown from its own computer."""

    console: Literal["auto", "events"] = "auto"
    """With --drone: as of `path-handoff sender`."""

    state: FileName = None
    """With --drone: as of `path-handoff sender`; a mission of your own writes nothing into it."""

    guard: Literal["start", "expect", "none"] = "start"
    """With --drone: as of `path-handoff sender`."""

    live: Live = None
    """Serve what is logged, as it is logged, to Foxglove, Lichtblick and `path-handoff view`: 127.0.0.1:8765 when no
    address is given. Other hosts than this one need a token (docs/view.md)."""

    gcs: Live = None
    """At `sitl`: let a ground station watch both vehicles, QGroundControl or MAVProxy, at this address; 127.0.0.1:14550
    when none is given. A mode that it selects is a pilot's word (docs/ground-station.md)."""

    px4: FileName = None
    """PX4's SITL binary (bin/px4 in its build folder), for the rigs that fly it; PATH_PX4 names it too."""

    ardupilot: FileName = None
    """ArduCopter's SITL binary, for the rigs that fly it; PATH_ARDUPILOT names it too."""


@dataclass(frozen=True, slots=True)
class SenderOptions(RoleOptions):
    """Fly the sender alone, as in the field: the receiver runs on the other drone."""


@dataclass(frozen=True, slots=True)
class ReceiverOptions(RoleOptions):
    """Fly the receiver alone, as in the field: the sender runs on the other drone."""


@dataclass(frozen=True, slots=True)
class GuardOptions:
    """Watch a vehicle on a link of its own; hold and land it when its script falls silent or a limit stays broken."""

    rig: RigName
    """A rig by name (see `path-handoff rigs`), or a rig's TOML file."""

    role: Literal["sender", "receiver", "both"] = "both"
    """Whose vehicle; both when one computer flies both."""

    out: OutFolder = None
    """Folder for the log; runs/<time> by default."""

    while_flown: bool = False
    """End by itself once the role's program is gone and its vehicle is down."""

    console: Literal["auto", "events"] = "auto"
    """events: started by another program; ends, as soon as nothing flies, when that closes this one's input."""

    live: Live = None
    """Serve what is logged, as it is logged, to Foxglove, Lichtblick and `path-handoff view`: 127.0.0.1:8765 when no
    address is given. Other hosts than this one need a token (docs/view.md)."""

    measure: bool = False
    """Fly a mission for each way a program can fail in each phase, and for another ground station's change of the mode;
    print how soon the vehicle is held, and down, and how soon its script lets go."""

    case: Annotated[tuple[str, ...], tyro.conf.arg(metavar="WORD"), tyro.conf.UseAppendAction] = ()
    """With --measure: only cases with this word in them, such as kill_sender or @verify; may be given several times."""


@dataclass(frozen=True, slots=True)
class DoctorOptions:
    """Check this machine, and a rig without moving anything."""

    rig: RigName = "sitl"
    """The rig to check: its file, its parts, its ports."""

    role: Literal["none", "sender", "receiver"] = "none"
    """Test each part of this role too: open it, measure for some seconds, close it. Nothing moves, nothing is set."""

    vehicle: Literal["none", "sender", "receiver"] = "none"
    """Connect to this role's vehicle as well, and compare its parameters with the rig's. Nothing moves."""

    slow: Slow = None
    """With --role: what this computer would hold if each role had this share of one core (docs/compute.md)."""

    set_parameters: bool = False
    """Set the vehicle's parameters to what the rig wants; what they were is kept in runs/parameters."""


@dataclass(frozen=True, slots=True)
class PrepareOptions:
    """Compile the kernels of a rig now: for images, for services, and before the first flight of a day."""

    rig: RigName = "sitl"
    """A rig by name (see `path-handoff rigs`), or a rig's TOML file."""


@dataclass(frozen=True, slots=True)
class RigsOptions:
    """List the rigs that come with PATH; write one of your own, or check it."""

    check: Annotated[str | None, tyro.conf.arg(metavar="NAME|FILE")] = None
    """Check everything in this rig that can be checked without touching hardware, as before a flight."""

    new: Annotated[str | None, tyro.conf.arg(metavar="FILE")] = None
    """Write a commented rig for the field into this file, and the key of its link beside it."""

    autopilot: Literal["px4", "ardupilot"] = "px4"
    """With --new: what flies both drones."""

    camera: Literal["realsense"] = "realsense"
    """With --new: what both drones see with."""


@dataclass(frozen=True, slots=True)
class ReportOptions:
    """Make summary, table and picture of a run again from its logs."""

    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")]
    """The folder of the run."""

    picture: bool = True
    """Draw run.png too."""


@dataclass(frozen=True, slots=True)
class ReplayOptions:
    """Decide again, from a run's logs, what its drones decided; or what they would have, with other settings."""

    folders: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="DIR ...")]
    """The folder of the run. With several, what was decided is decided again in each, and counted."""

    set: Annotated[tuple[str, ...], tyro.conf.arg(metavar="method.NAME=VALUE"), tyro.conf.UseAppendAction] = ()
    """A setting of the rig's [method] to decide with instead, such as method.tau_min=0.4, or of its detector, such as
    detector.min_saturation=0.4; may be given several times. Without any (and without --gate) every decision must come
    out as it was logged."""

    frames: bool = False
    """Look again at the recorded frames (`record = "all"`) instead of taking what the log says was seen."""

    detector: Annotated[str | None, tyro.conf.arg(metavar="MODULE:CLASS")] = None
    """With --frames, which it implies: another detector than the rig's, for both drones."""

    rig: str | None = None
    """With --frames: the rig whose perception looks; the one that was flown by default."""

    gate: Literal["count", "evidence"] | None = None
    """The gate to decide with instead."""

    picture: bool = True
    """Draw replay.png when something is decided otherwise."""


@dataclass(frozen=True, slots=True)
class MergeOptions:
    """Put the logs of a run, or of two companions, into one on one clock."""

    logs: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="DIR|FILE ...")]
    """Folders of runs, or logs (.mcap). A log's name goes before its topics."""

    out: FileName = None
    """The merged log; merged.mcap beside the first one by default."""


@dataclass(frozen=True, slots=True)
class ExportOptions:
    """Write what a run's logs hold in forms that other programs read."""

    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")]
    """The folder of the run."""

    tum: bool = False
    """Trajectories, as evo reads them."""

    csv: bool = False
    """A table for each topic of each log."""

    out: OutFolder = None
    """The folder to write to; `export` in the run's folder by default."""


@dataclass(frozen=True, slots=True)
class ViewOptions:
    """Look at a run in Rerun: the scene, both images, plots, words. Needs the extra `view` (docs/view.md)."""

    logs: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="DIR|FILE ...")] = ()
    """Folders of runs, or logs (.mcap); a drone's own log and a merged one will do."""

    live: Annotated[tuple[str, ...], tyro.conf.arg(metavar="HOST:PORT ...")] = ()
    """Flights to look at as they go, instead of logs: what their --live was told. A token goes behind the port:
    10.0.0.5:8765/?token=..."""

    web: bool = False
    """As a page that this computer serves to itself, instead of a window. It needs no internet."""

    port: Annotated[int, Bounds(1, 65535, "(a port)")] = 9090
    """With --web: the page's."""

    save: FileName = None
    """Write Rerun's own file (.rrd) instead of showing anything."""

    layout: FileName = None
    """Write the layout for Foxglove and Lichtblick into this file (.json) instead; no run is needed for it."""


@dataclass(frozen=True, slots=True)
class TrialOptions:
    """Run one of the paper's experiments, or all of them, and hold what comes out against the paper."""

    name: Annotated[TrialName, tyro.conf.Positional]
    """Which trial; `all` runs those of the paper and makes one page, in about a quarter of an hour on two cores.
    `processes`, `rendezvous`, `beacon`, `soak` and, without --set, `real` are asked for by name."""

    out: OutFolder = None
    """Folder for the page, summary.json and the pictures; trials/<time>-<name> by default."""

    seed: Seed = 0
    """Seed of every random number: the same seed gives the same figures (timings apart)."""

    quick: bool = False
    """The same code on few samples: does it run, not what comes out."""

    jobs: Jobs = 0
    """Processes at a time; 0: one per core."""

    rig: Annotated[str | None, tyro.conf.arg(metavar="NAME|FILE")] = None
    """The rig; by default sim-rendered, whose harness knows the truth; `dynamic` for `beacon`, `sim-field` for
    `rendezvous`, `sitl` for `soak`."""

    errors: Errors = None
    """Errors of the world of flights and Monte-Carlo hand-overs against what the rig says (docs/errors.md); careful
    unless the rig says otherwise. `static` and `ambiguity` have errors of their own."""

    xfeat: FileName = None
    """Weights of XFeat (ONNX), for the trials that compare with it; without them XFeat is left out."""

    logs: OutFolder = None
    """Folder with the logs of a session, for `beacon`: it is judged as if it were flown now."""

    seconds: Annotated[float, Bounds(0.0, 1e6)] = 0.0
    """The time for which `soak` verifies, 0: 20 minutes; or `beacon` records where the drones are flown from their own
    computers, 0: until Ctrl-C."""

    board: FileName = None
    """TOML file that describes a photograph of a marker board, for `corners`; without it no photograph is measured."""

    set: Annotated[tuple[tuple[Path, ...], ...], tyro.conf.arg(metavar="FILE ..."), tyro.conf.UseAppendAction] = ()
    """TOML files that describe sets of photographs of a board, for `real` (docs/real.md); may be given several
    times."""

    photographs: OutFolder = None
    """The folder that paths in --set's files are relative to; by default each file's own folder."""


@dataclass(frozen=True, slots=True)
class VerifyOptions:
    """Walk through everything that loss, delay, crashes and clocks can do to a hand-over, and hold it to its rules."""

    out: OutFolder = None
    """Folder for summary.json; verify/<time> by default."""

    quick: bool = False
    """Small scopes only, in half a minute; all of them take some minutes."""

    jobs: Jobs = 0
    """Processes at a time; 0: one per core."""

    wire: Annotated[int, Bounds(0, 10_000_000_000, "packets")] = 0
    """Throw this many forged, altered and repeated packets at the link instead: 10000000 take about a minute."""

    mutants: bool = False
    """Instead, change the code of the protocol, its wiring, the wire and the guard's rules in small wrong ways, and see
    whether the tests notice. In a checkout with what `.[dev]` brings; most of an hour on two cores."""

    sample: Annotated[int, Bounds(1, 1_000_000, "changes")] = 168
    """The number of changes, of more than a thousand."""

    seed: Seed = 0
    """Seed of the forged packets, and of which changes are made."""


@dataclass(frozen=True, slots=True)
class CampaignOptions:
    """Fly many hand-overs under faults, each by its own seed, and hold every one to S1-S10, L1 and L2.

    levels: none (a good link), lossy (10-30 % loss, 50 ms jitter, duplicates, reordering), harsh (30-50 % loss, 200 ms
    jitter, damage, outages, programs killed and started again, clocks at their drift), hostile (also clocks that are
    set, forged and repeated packets, pilots, a receiver that does not see the target). See docs/campaign.md.
    """

    program: Literal["machines", "roles", "team"] = "machines"
    """machines: both protocol machines, real messages; roles: both whole role programs; team: whole teams."""

    runs: Annotated[int, Bounds(1, 100_000_000, "runs")] = 1000
    """The number of runs, shared out among the levels."""

    faults: Annotated[tuple[LevelName, ...], tyro.conf.arg(metavar="LEVEL ...")] = ()
    """The levels of faults; all of them by default."""

    seed: Seed = 0
    """Seed of the campaign: with level and number it makes a run what it is."""

    only: Annotated[int | None, tyro.conf.arg(metavar="NUMBER"), Bounds(0, 2**31, "(a number)")] = None
    """Fly this run alone and tell its story: how a failure is looked at."""

    out: OutFolder = None
    """Folder of the results, gone on with when it has some; campaigns/<time>-<program> by default."""

    jobs: Jobs = 0
    """Processes at a time; 0: one per core."""

    cluster: Annotated[str | None, tyro.conf.arg(metavar="ADDRESS")] = None
    """A Dask scheduler that does the work instead, such as tcp://192.168.1.5:8786."""

    rig: RigName = "sim"
    """The rig that is flown, of level sim; with --program team it is team-sim by default."""

    hours: Annotated[float | None, Bounds(0.0, 1000.0, above=True)] = None
    """With --program team: how long each team flies; as its rig says by default."""

    junit: FileName = None
    """Write a JUnit file too: a test case a run, failed by what it violated, with the line that replays it."""

    errors: Errors = None
    """Errors of the simulated world against the rig (docs/errors.md); careful unless the rig says otherwise."""


@dataclass(frozen=True, slots=True)
class ConformanceOptions:
    """Fly the embedded vehicle, PX4 and ArduPilot through the same small checks, and show where they differ.

    In real time, four to ten minutes each; a busy computer shows in the figures. See docs/conformance.md.
    """

    vehicle: tuple[Literal["embedded", "px4", "ardupilot"], ...] = ()
    """Which; all of them by default. One whose simulator is not named is skipped."""

    px4: FileName = None
    """PX4's SITL binary (bin/px4 in its build folder); PATH_PX4 names it too."""

    ardupilot: FileName = None
    """ArduCopter's SITL binary; PATH_ARDUPILOT names it too."""

    only: Annotated[tuple[str, ...], tyro.conf.arg(metavar="WORD"), tyro.conf.UseAppendAction] = ()
    """Only flights with this word in their name, such as course or silent; may be given several times. What they give
    goes into the record that --out has of the vehicle already."""

    out: OutFolder = None
    """Folder of the records, one a vehicle; those that are there already are shown too; conformance/<time> by
    default."""

    page: FileName = None
    """Write the table as a page of Markdown."""

    fly: bool = True
    """--no-fly: fly nothing, show the records of --out."""


@dataclass(frozen=True, slots=True)
class BoardOptions:
    """The printed board, as measured on the print."""

    board: Literal["charuco", "chessboard"] = "charuco"
    """Pattern. ChArUco may be seen in part, so it reaches the corners of the image: there the distortion shows."""

    squares: Annotated[str, tyro.conf.arg(metavar="COLUMNSxROWS")] = "10x7"
    """Squares of the board, of either pattern: a chessboard of 10x7 squares has 9x6 inner corners."""

    square_m: Annotated[float, Bounds(0.002, 1.0)] = 0.030
    """Side of a square."""

    marker_m: Annotated[float, Bounds(0.001, 1.0)] = 0.0225
    """Side of the black frame of a ChArUco board's markers."""

    dictionary: str = "DICT_4X4_50"
    """OpenCV's dictionary of these markers."""

    legacy: bool = False
    """The board is a ChArUco one as OpenCV drew it before 4.6; of images and films that is also found out."""


@dataclass(frozen=True, slots=True)
class CalibrateCameraOptions(BoardOptions):
    """Calibrate a camera from views of a board: of images, a video, or a rig's camera as it runs."""

    images: OutFolder = None
    """Folder of images, one view each."""

    video: FileName = None
    """Video file, image folder with stamps, or .mcap log: still and different views are chosen from it."""

    rig: Annotated[str, tyro.conf.arg(metavar="NAME|FILE")] = ""
    """Rig whose camera is to be calibrated as it runs."""

    role: Literal["sender", "receiver"] = "sender"
    """Whose camera of the rig."""

    views: Annotated[int, Bounds(3, 10_000, "views")] = 40
    """Views to choose from a video, or to take with a running camera."""

    seconds: Annotated[float, Bounds(1.0, 36_000.0)] = 300.0
    """A running camera is given up after this time."""

    serial: str = ""
    """Serial number of the camera, to tie the calibration to; a running camera that knows its own tells it itself."""

    out: Annotated[Path, tyro.conf.arg(metavar="FILE")] = Path("camera.toml")
    """The calibration; beside it a picture of the same name, and the views that a running camera gave."""


@dataclass(frozen=True, slots=True)
class CalibrateMountOptions(BoardOptions):
    """Find where D1's camera is, seen from its marker (T_v_c1): from views of a board, or from a tape measure."""

    rig: Annotated[str, tyro.conf.arg(metavar="NAME|FILE")] = ""
    """Rig with the markers, and D1's camera and its calibration."""

    images: OutFolder = None
    """Images of D1's camera that show the board."""

    other_images: OutFolder = None
    """Images of another camera, of the same names and moments, that show the same board and D1's marker."""

    other_camera: FileName = None
    """Calibration of that other camera, as made by `path-handoff calibrate camera`."""

    measured: FileName = None
    """Instead of images: TOML file with what a tape measure and a protractor say (docs/calibration.md)."""

    out: Annotated[Path, tyro.conf.arg(metavar="FILE")] = Path("mount.toml")
    """The calibration."""


@dataclass(frozen=True, slots=True)
class CalibrateBoardOptions(BoardOptions):
    """Draw a board to print."""

    dpi: Annotated[int, Bounds(30, 4800, "dots per inch")] = 600
    """Dots per inch of the printer: cells become whole dots."""

    out: Annotated[Path, tyro.conf.arg(metavar="FILE")] = Path("board.png")
    """The picture, PNG."""


@dataclass(frozen=True, slots=True)
class CalibrateOptions:
    """Calibrate a camera, or where it sits relative to the marker; or draw a board to print."""

    what: (
        Annotated[CalibrateCameraOptions, tyro.conf.subcommand("camera")]
        | Annotated[CalibrateMountOptions, tyro.conf.subcommand("mount")]
        | Annotated[CalibrateBoardOptions, tyro.conf.subcommand("board")]
    )


@dataclass(frozen=True, slots=True)
class DetectOptions:
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

    out: OutFolder = None
    """Folder for boxes.csv and for the frames with their boxes drawn; nothing is written by default."""
