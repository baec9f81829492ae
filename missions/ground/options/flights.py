"""The options of the commands that fly both drones, or many, with a simulated world."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tyro

from missions.ground.options.words import (
    AnyRig,
    ArduPilotBinary,
    DetectorModel,
    ErrorLevel,
    Errors,
    Faults,
    FileName,
    GroundStation,
    JobCount,
    LegFaults,
    Live,
    OutFolder,
    Px4Binary,
    RigChoice,
    RigName,
    RunFolder,
    RunSeed,
    Seed,
    Slow,
)
from path.bounds import Bounds
from path.values import frozen


@frozen
class HandoffOptions(RigChoice):
    """Fly a whole handoff: both drones, and the world when the rig has a simulated one."""

    rig: AnyRig = "sitl"

    seed: RunSeed = 0

    seeds: Annotated[int, Bounds(1, 1_000_000, "runs")] = 1
    """Fly this many runs with seeds from --seed on, and print what became of them."""

    jobs: JobCount = 0
    """Runs at a time with --seeds; 0: one per core. Rigs in real time fly one at a time."""

    fault: Faults = ()
    """Faults to try, such as lookalike, link_loss=0.3 or kill_sender=1@verify+2; may be given
    several times.
    """

    errors: ErrorLevel = None
    """Errors of the simulated world against the rig (docs/errors.md): as a careful crew leaves it,
    three times that, or not at all; careful unless the rig says otherwise."""

    scene: str | None = None
    """At `sim-rendered`: the scene that the cameras see, such as outdoor-sun or dusk
    (docs/errors.md).
    """

    out: RunFolder = None

    junit: FileName = None
    """With --seeds: write a JUnit file too, a test case a run, failed unless it committed."""

    slow: Slow = None
    """At `sitl`: confine each role's program to this share of one core, 0.2 for a fifth, by a
    control group (docs/compute.md)."""

    picture: bool = True
    """Draw run.png at the end."""

    live: Live = None

    gcs: GroundStation = None

    serve_world: bool = False
    """At `sitl`: run the world alone, and wait for `path-handoff sender` and `receiver` from two
    other shells, as on two companions. What to type is printed (docs/field.md)."""

    px4: Px4Binary = None

    ardupilot: ArduPilotBinary = None

    model: DetectorModel = None


@frozen
class HoursOptions(RigChoice):
    """The options of what many drones fly for hours."""

    hours: Annotated[float | None, Bounds(0.0, 1000.0, above=True)] = None
    """For how long; then everybody comes home. By default as the rig says: hours in simulated time,
    minutes in real time."""

    seed: Seed = 0
    """Seed of the world and of every noise: in simulated time the same seed is the same flight."""

    fault: LegFaults = ()

    out: RunFolder = None

    errors: Errors = None

    logs: bool = False
    """Log everything, frame by frame, and not only what is decided: some 40 MB for each hour of a
    drone.
    """

    live: Live = None

    gcs: GroundStation = None

    picture: bool = True
    """Draw relay.png or team.png at the end."""


@frozen
class RehearseOptions:
    """Fly a rig of the field in the harness as it is, its hardware replaced behind the drivers."""

    rig: Annotated[AnyRig, tyro.conf.Positional]

    level: Literal["sim", "sim-rendered", "sitl"] = "sim"
    """sim: observations from geometry, in virtual time; sim-rendered: rendered frames; sitl: real
    time, MAVSDK.
    """

    seed: RunSeed = 0

    seeds: Annotated[int, Bounds(1, 1_000_000, "runs")] = 1
    """Fly this many runs with seeds from --seed on, and print what became of them."""

    jobs: JobCount = 0
    """Runs at a time with --seeds; 0: one per core."""

    fault: Faults = ()
    """Faults to try, such as lookalike or kill_sender=1@verify+2; may be given several times."""

    errors: ErrorLevel = None
    """Errors of the simulated world against the rig (docs/errors.md)."""

    out: RunFolder = None


@frozen
class RelayOptions(HoursOptions):
    """Hand one target from drone to drone as batteries run down: hours in simulated time, or
    minutes in real time.
    """

    rig: RigName = "relay"
    """A rig with a [relay] table: its drones, their homes and batteries (docs/relay.md). At level
    sim: simulated, as fast as it computes; at sitl: in real time, each drone's program a process of
    its own."""

    drones: Annotated[int, Bounds(2, 100, "drones")] = 3
    """The number of the rig's drones that take part, from its first one on."""


@frozen
class TeamOptions(HoursOptions):
    """Keep many targets observed by many drones for hours, which relieve each other as batteries
    run down.
    """

    rig: RigName = "team"
    """A rig with [team], [[drones]] and [[targets]] (docs/team.md)."""

    drones: Annotated[int | None, Bounds(2, 1000, "drones")] = None
    """The number of drones; those of the rig by default, and a field laid out like it for more than
    it names.
    """

    targets: Annotated[int | None, Bounds(1, 1000, "targets")] = None
    """The number of targets; those of the rig by default, and a field laid out like it for more
    than it names.
    """


@frozen
class FlyOptions(RigChoice):
    """Fly a mission of your own: both drones, and the world when the rig has a simulated one."""

    mission: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MISSION.py")]
    """The mission's file (docs/own-missions.md)."""

    rig: AnyRig = "sim"

    seed: RunSeed = 0

    fault: Faults = ()
    """Faults to try, such as link_loss=0.3 or kill_sender@mission+5; may be given several times."""

    errors: Errors = None

    out: OutFolder = None
    """Folder for logs and summary; runs/<time> by default."""

    drone: Literal["both", "sender", "receiver"] = "both"
    """Fly this drone of the rig alone, as in the field: the other one is flown from its own
    computer.
    """

    console: Literal["auto", "events"] = "auto"
    """With --drone: as of `path-handoff sender`."""

    state: FileName = None
    """With --drone: as of `path-handoff sender`; a mission of your own writes nothing into it."""

    guard: Literal["start", "expect", "none"] = "start"
    """With --drone: as of `path-handoff sender`."""

    live: Live = None

    gcs: GroundStation = None

    px4: Px4Binary = None

    ardupilot: ArduPilotBinary = None

    model: DetectorModel = None


@frozen
class StandInOptions:
    """Switch on one part alone, for programs of others to be tried against, until Ctrl-C."""

    what: Annotated[Literal["vehicle", "tello", "camera", "hedgehog"], tyro.conf.Positional] = (
        "vehicle"
    )
    """vehicle: an embedded autopilot that speaks MAVLink; tello: with its video; camera: what the
    rig's sees, as H.264 by UDP; hedgehog: a Marvelmind beacon on the target, as a serial port.
    """

    rig: RigName = ""
    """The rig whose simulated sender it is: its drone, camera, world and wind; by default sim,
    of a Tello sitl-tello, of a camera sitl.
    """

    port: Annotated[int | None, Bounds(1024, 65535, "(a port)")] = None
    """UDP port: of this computer, that a vehicle (14540) or camera (5600) sends to; or that a Tello
    listens on (8899), at an address of its own.
    """

    two: bool = False
    """The rig's receiver as well: on the next port, or at the next address; a hedgehog on D1."""

    seed: RunSeed = 0
