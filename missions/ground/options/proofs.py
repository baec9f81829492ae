"""The options of trials, of the proofs, and of what simulated vehicles are worth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tyro

from missions.ground.options.words import (
    ErrorLevel,
    Errors,
    FileName,
    Jobs,
    LevelName,
    OutFolder,
    RigName,
    Seed,
)
from path.bounds import Bounds
from path.values import frozen

QuestionName = Literal["pose", "handovers", "flights", "rivals", "cost"]
ExperimentName = Literal[
    "sensitivity", "static", "corners", "calibration", "real", "common-view",
    "handshake", "evidence", "recall",
    "dynamic", "beacon", "wash", "obstacles",
    "ambiguity",
    "link", "compute", "soak",
]  # fmt: skip
TrialName = Literal["all"] | QuestionName | ExperimentName


@frozen
class TrialOptions:
    """Ask one of the evaluation's questions, or all of them, and hold what comes out against the
    paper.

    pose: where D2 and the target are, by single frames (sensitivity, static, corners, calibration,
    real, common-view). handovers: how soon they agree, and whether ever wrongly (handshake, evidence, recall).
    flights: whole missions (dynamic, beacon, wash, obstacles). rivals: PATH, ORB and XFeat (ambiguity).
    cost: time, bytes, memory, and what it bears (link, compute, soak).
    """

    name: Annotated[TrialName, tyro.conf.Positional]
    """The question. The name of an experiment alone is what --only says; it is taken for one more
    release.
    """

    only: Annotated[tuple[ExperimentName, ...], tyro.conf.arg(metavar="EXPERIMENT ...")] = ()
    """Of the question's experiments only these."""

    out: OutFolder = None
    """Folder for the page, summary.json and the pictures; trials/<time>-<name> by default."""

    seed: Seed = 0
    """Seed of every random number: the same seed gives the same figures (timings apart)."""

    quick: bool = False
    """The same code on few samples: does it run, not what comes out."""

    jobs: Jobs = 0

    rig: Annotated[str | None, tyro.conf.arg(metavar="NAME|FILE")] = None
    """The rig, in place of sim-rendered, whose harness knows the truth. beacon flies `dynamic`
    and soak `sitl` unless they are asked for alone."""

    errors: ErrorLevel = None
    """Errors of the world of flights and Monte-Carlo hand-overs against what the rig says
    (docs/errors.md); careful unless the rig says otherwise. `static` and `ambiguity` have errors of
    their own."""

    xfeat: FileName = None
    """Weights of XFeat (ONNX), for ambiguity and compute; without them XFeat is left out."""

    method: Annotated[str | None, tyro.conf.arg(metavar="FILE.py:NAME")] = None
    """A method of your own, for ambiguity: asked on the same frames (docs/own-parts.md)."""

    logs: OutFolder = None
    """Folder with the logs of a session, for beacon: it is judged as if it were flown now."""

    seconds: Annotated[float, Bounds(0.0, 1e6)] = 0.0
    """The time for which soak verifies, 0: 20 minutes; or beacon records where the drones are flown
    from their own computers, 0: until Ctrl-C."""

    set: Annotated[
        tuple[tuple[Path, ...], ...], tyro.conf.arg(metavar="FILE ..."), tyro.conf.UseAppendAction
    ] = ()
    """TOML files that describe photographs of a board, for real (docs/real.md); may be given
    several times.
    """

    photographs: OutFolder = None
    """The folder that paths in --set's files are relative to; by default each file's own folder."""

    common_view: OutFolder = None
    """Folder of an RGB-D sequence with poses, for common-view, which alone is run then
    (docs/common-view.md).
    """


@frozen
class VerifyOptions:
    """Walk through everything that loss, delay, crashes and clocks can do to a hand-over, and hold
    it to its rules.
    """

    out: OutFolder = None
    """Folder for summary.json; verify/<time> by default."""

    quick: bool = False
    """Small scopes only, in half a minute; all of them take some minutes."""

    jobs: Jobs = 0

    wire: Annotated[int, Bounds(0, 10_000_000_000, "packets")] = 0
    """Throw this many forged, altered and repeated packets at the link instead: 10000000 take about
    a minute.
    """

    seed: Seed = 0
    """Seed of the forged packets."""


@frozen
class CampaignOptions:
    """Fly many hand-overs under faults, each by its own seed, and hold every one to S1-S10, L1 and
    L2.

    levels: none (a good link), lossy (10-30 % loss, 50 ms jitter, duplicates, reordering), harsh
    (30-50 % loss, 200 ms jitter, damage, outages, programs killed and started again, clocks at
    their drift), hostile (also clocks that are set, forged and repeated packets, pilots, a receiver
    that does not see the target). See docs/campaign.md.
    """

    program: Literal["machines", "roles", "team"] = "machines"
    """machines: both protocol machines, real messages; roles: both whole role programs; team: whole
    teams.
    """

    runs: Annotated[int, Bounds(1, 100_000_000, "runs")] = 1000
    """The number of runs, shared out among the levels."""

    faults: Annotated[tuple[LevelName, ...], tyro.conf.arg(metavar="LEVEL ...")] = ()
    """The levels of faults; all of them by default."""

    seed: Seed = 0
    """Seed of the campaign: with level and number it makes a run what it is."""

    only: Annotated[int | None, tyro.conf.arg(metavar="NUMBER"), Bounds(0, 2**31, "(a number)")] = (
        None
    )
    """Fly this run alone and tell its story: how a failure is looked at."""

    out: OutFolder = None
    """Folder of the results, gone on with when it has some; campaigns/<time>-<program> by
    default.
    """

    jobs: Jobs = 0

    cluster: Annotated[str | None, tyro.conf.arg(metavar="ADDRESS")] = None
    """A Dask scheduler that does the work instead, such as tcp://192.168.1.5:8786."""

    rig: RigName = "sim"
    """The rig that is flown, of level sim; with --program team it is team-sim by default."""

    hours: Annotated[float | None, Bounds(0.0, 1000.0, above=True)] = None
    """With --program team: how long each team flies; as its rig says by default."""

    junit: FileName = None
    """Write a JUnit file too: a test case a run, failed by what it violated, with the line that
    replays it.
    """

    errors: Errors = None


@frozen
class ConformanceOptions:
    """Fly the embedded vehicle, PX4 and ArduPilot through the same small checks, and show where
    they differ.

    In real time, four to ten minutes each; a busy computer shows in the figures. See
    docs/conformance.md.
    """

    vehicle: tuple[Literal["embedded", "px4", "ardupilot"], ...] = ()
    """The vehicles to fly; all of them by default. One whose simulator is not named is skipped."""

    px4: FileName = None
    """PX4's SITL binary (bin/px4 in its build folder); PATH_PX4 names it too."""

    ardupilot: FileName = None
    """ArduCopter's SITL binary; PATH_ARDUPILOT names it too."""

    only: Annotated[tuple[str, ...], tyro.conf.arg(metavar="WORD"), tyro.conf.UseAppendAction] = ()
    """Only flights with this word in their name, such as course or silent; may be given several
    times. What they give goes into the record that --out has of the vehicle already."""

    out: OutFolder = None
    """Folder of the records, one a vehicle; those that are there already are shown too;
    conformance/<time> by default."""

    page: FileName = None
    """Write the table as a page of Markdown."""

    fly: bool = True
    """--no-fly: fly nothing, show the records of --out."""
