"""The options of the commands that read what a run left."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tyro

from missions.ground.options.words import FileName, OutFolder
from path.bounds import Bounds
from path.values import frozen


@frozen
class ReportOptions:
    """Make summary, table and picture of a run again from its logs."""

    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")]
    """The folder of the run."""

    picture: bool = True
    """Draw run.png too."""


@frozen
class ReplayOptions:
    """Decide again, from a run's logs, what its drones decided; or what they would have, with other
    settings; or over two films that were made without PATH."""

    folders: Annotated[
        tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="DIR ...|FILMS.toml")
    ]
    """The folder of the run. With several, what was decided is decided again in each, and counted.
    Or the file that names two films (docs/films.md)."""

    set: Annotated[
        tuple[str, ...], tyro.conf.arg(metavar="method.NAME=VALUE"), tyro.conf.UseAppendAction
    ] = ()
    """A setting of the rig's [method] to decide with instead, such as method.tau_min=0.4, or of its
    detector, such as detector.min_saturation=0.4; may be given several times. Without any (and
    without --gate) every decision must come out as it was logged."""

    frames: bool = False
    """Look again at the recorded frames (`record = "all"`) instead of taking what the log says was
    seen.
    """

    detector: Annotated[str | None, tyro.conf.arg(metavar="MODULE:CLASS")] = None
    """With --frames, which it implies: another detector than the rig's, for both drones."""

    rig: str | None = None
    """With --frames: the rig whose perception looks; the one that was flown by default."""

    gate: Literal["count", "evidence", "likelihood"] | None = None
    """The gate to decide with instead."""

    out: OutFolder = None
    """Of films: the folder for logs, table and picture; runs/<time> by default."""

    picture: bool = True
    """Draw replay.png when something is decided otherwise, or films were looked at."""


@frozen
class MergeOptions:
    """Put the logs of a run, or of two companions, into one on one clock."""

    logs: Annotated[
        tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="DIR|FILE|HOST:DIR ...")
    ]
    """Folders of runs, or logs (.mcap). A log's name goes before its topics. What is on another
    computer, such as d1:flights/runs/20261121-114500, is fetched first, with scp, into a folder of
    this one (d1-20261121-114500)."""

    out: FileName = None
    """The merged log; merged.mcap beside the first one by default."""


@frozen
class ExportOptions:
    """Write what a run's logs hold in forms that other programs read; or a RealSense recording as
    images.
    """

    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR|FILE.db3")]
    """The folder of the run; or a RealSense recording (.db3, .bag) or a bag of ROS, of which
    colour, depth, stamps and calibration are written (docs/films.md)."""

    tum: bool = False
    """Trajectories, as evo reads them."""

    csv: bool = False
    """A table for each topic of each log."""

    ros2: bool = False
    """A bag of ROS 2 with standard messages, which `ros2 bag play` plays (docs/logs.md). Needs the
    extra `ros`.
    """

    publish: str | None = None
    """With --ros2: publish what the logs say while they are written, until Ctrl-C, through the zenoh
    router that listens there, such as tcp/127.0.0.1:7447, as topics of rmw_zenoh. Needs the extra
    `ros-live`.
    """

    calibration: FileName = None
    """Of a RealSense recording: the colour camera's, instead of its maker's; depth is registered by
    it.
    """

    out: OutFolder = None
    """The folder to write to; by default `export` in the run's folder, and one beside a recording
    with its name.
    """


@frozen
class ViewOptions:
    """Look at a run in Rerun: the scene, both images, plots, words. Needs the extra `view`
    (docs/logs.md).
    """

    logs: Annotated[
        tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="DIR|FILE ...")
    ] = ()
    """Folders of runs, or logs (.mcap); a drone's own log and a merged one will do."""

    live: Annotated[tuple[str, ...], tyro.conf.arg(metavar="HOST:PORT ...")] = ()
    """Flights to look at as they go, instead of logs: what their --live was told. A token goes
    behind the port: 10.0.0.5:8765/?token=..."""

    web: bool = False
    """As a page that this computer serves to itself, instead of a window. It needs no internet."""

    port: Annotated[int, Bounds(1, 65535, "(a port)")] = 9090
    """With --web: the page's."""

    save: FileName = None
    """Write Rerun's own file (.rrd) instead of showing anything."""

    layout: FileName = None
    """Write the layout for Foxglove and Lichtblick into this file (.json) instead; no run is needed
    for it.
    """
