"""The types of several commands' options, their bounds, and their help where it is the same."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from path.bounds import Bounds

MOST_SEED = 2**32 - 1
Seed = Annotated[int, Bounds(0, MOST_SEED, "(a seed)")]
RunSeed = Annotated[
    Seed,
    tyro.conf.arg(
        help="Seed of the world and of every noise: the same seed is the same run at the sim levels."
    ),
]
JobCount = Annotated[int, Bounds(0, 1024, "processes")]
Jobs = Annotated[JobCount, tyro.conf.arg(help="Processes at a time; 0: one per core.")]
RigName = Annotated[str, tyro.conf.arg(metavar="NAME|FILE")]
AnyRig = Annotated[
    str,
    tyro.conf.arg(
        metavar="NAME|FILE", help="A rig by name (see `path-handoff rigs`), or a rig's TOML file."
    ),
]
LevelName = Literal["none", "lossy", "harsh", "hostile"]
OutFolder = Annotated[Path | None, tyro.conf.arg(metavar="DIR")]
RunFolder = Annotated[
    Path | None,
    tyro.conf.arg(
        metavar="DIR", help="Folder for logs, summary and picture; runs/<time> by default."
    ),
]
LogFolder = Annotated[
    Path | None, tyro.conf.arg(metavar="DIR", help="Folder for the log; runs/<time> by default.")
]
FileName = Annotated[Path | None, tyro.conf.arg(metavar="FILE")]
Px4Binary = Annotated[
    Path | None,
    tyro.conf.arg(
        metavar="FILE",
        help="PX4's SITL binary (bin/px4 in its build folder), for the rigs that fly it; PATH_PX4 names it too.",
    ),
]
ArduPilotBinary = Annotated[
    Path | None,
    tyro.conf.arg(
        metavar="FILE",
        help="ArduCopter's SITL binary, for the rigs that fly it; PATH_ARDUPILOT names it too.",
    ),
]
DetectorModel = Annotated[
    Path | None,
    tyro.conf.arg(
        metavar="FILE",
        help="YOLOX model (ONNX) for rigs that look with one, such as sim-rendered-person (docs/detectors.md); "
        "PATH_YOLOX names it too.",
    ),
]
Live = Annotated[
    str | None,
    tyro.conf.arg(
        metavar="HOST:PORT",
        help="Serve a page for the crew, for a phone or a laptop, and what is logged, as it is logged, to Foxglove and "
        "`path-handoff view`: 127.0.0.1:8765 when no address is given. Other hosts need a token (docs/live.md).",
    ),
]
GroundStation = Annotated[
    str | None,
    tyro.conf.arg(
        metavar="HOST:PORT",
        help="At `sitl`: let a ground station watch both vehicles, QGroundControl or MAVProxy, at this address; "
        "127.0.0.1:14550 when none is given. A mode that it selects is a pilot's word (docs/ground-station.md).",
    ),
]
ErrorLevel = Literal["exact", "careful", "careless"] | None
Slow = Annotated[float | None, Bounds(0.02, 1.0, "of a core")]
Errors = Annotated[
    ErrorLevel,
    tyro.conf.arg(
        help="Errors of the simulated world against the rig (docs/errors.md); careful unless the rig says otherwise."
    ),
]
Faults = Annotated[
    tuple[str, ...],
    tyro.conf.arg(name="fault", metavar="NAME[=VALUE][@MOMENT[+SECONDS]]"),
    tyro.conf.UseAppendAction,
]
LegFaults = Annotated[
    tuple[str, ...],
    tyro.conf.arg(
        name="fault",
        metavar="[LEG:]NAME[=VALUE][@MOMENT[+SECONDS]]",
        help="Faults to try: in every leg, such as link_loss=0.3, or in one, such as 3:kill_receiver@approach; "
        "may be given several times.",
    ),
    tyro.conf.UseAppendAction,
]


@dataclass(frozen=True, slots=True, kw_only=True)
class RigChoice:
    """What a rig that comes with PATH is flown as, beside its name; ``path-handoff rigs`` shows what
    each comes as. ``missions.cli`` makes one name of them.
    """

    level: Literal["sim", "sim-rendered", "sitl"] | None = None
    """Of a rig that comes with PATH: sim: observations from geometry, in virtual time; sim-rendered:
    rendered frames; sitl: real time, MAVSDK, sockets."""

    autopilot: Literal["embedded", "px4", "ardupilot", "mixed"] | None = None
    """... and what flies both drones; mixed: PX4 flies D1, ArduPilot D2."""

    light: bool = False
    """... over a short agreement, with small pictures: for many runs, also on a busy computer."""
