"""``path-handoff``: the commands a person starts. Each imports what it needs, and only then."""

from __future__ import annotations

import errno
import importlib
import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from importlib.metadata import version
from typing import Annotated

import tyro

from flight.command_end import CommandEnd
from missions.kernel_cache import have_kernel_cache
from missions.options.calibrate import CalibrateOptions
from missions.options.field import (
    DetectOptions,
    DoctorOptions,
    GuardOptions,
    PrepareOptions,
    ReceiverOptions,
    RigsOptions,
    SenderOptions,
)
from missions.options.flights import FlyOptions, HandoffOptions, RelayOptions, TeamOptions
from missions.options.proofs import CampaignOptions, ConformanceOptions, TrialOptions, VerifyOptions
from missions.options.runs import ExportOptions, MergeOptions, ReplayOptions, ReportOptions, ViewOptions
from missions.shown import drop, flush_or_drop, say_unwritten
from path.bounds import out_of_bounds

MODULES: dict[type[object], str] = {
    HandoffOptions: "handoff.command",
    RelayOptions: "relay.command",
    TeamOptions: "team.command",
    FlyOptions: "own.command",
    SenderOptions: "leg.command",
    ReceiverOptions: "leg.command",
    GuardOptions: "guard.command",
    DoctorOptions: "doctor.command",
    PrepareOptions: "prepare",
    RigsOptions: "rig_list",
    ReportOptions: "report.command",
    ReplayOptions: "replay.command",
    ViewOptions: "view.command",
    MergeOptions: "logs.merge",
    ExportOptions: "logs.export",
    TrialOptions: "trials.run",
    VerifyOptions: "assurance.verify.run",
    CampaignOptions: "assurance.campaign.run",
    ConformanceOptions: "assurance.conformance.run",
    CalibrateOptions: "calibrate.run",
    DetectOptions: "detect",
}
"""Each has ``run(options) -> exit code``."""

EXIT_REFUSED = CommandEnd.REFUSED.exit_code
EXIT_CTRL_C = CommandEnd.STOPPED.exit_code
EXIT_BROKEN_PIPE = CommandEnd.READER_GONE.exit_code
USUAL = {"--live": "127.0.0.1:8765", "--gcs": "127.0.0.1:14550"}
UNWRITTEN = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS, errno.EACCES, errno.EPERM)
"""Errors of the place that is written to, and not of PATH."""

DESCRIPTION = """Two drones pass a moving target, with proof that it is the same target.

examples:
  path-handoff handoff                        a whole handoff in real time, in a simulated world
  path-handoff handoff --rig sim --seed 7     the same course, as fast as it computes
  path-handoff handoff --fault link_loss=0.3  what happens when things go wrong
  path-handoff relay --drones 3 --hours 8     one target, handed round as batteries run down
  path-handoff team                           three targets kept observed by six drones
  path-handoff replay runs/20261104-101500    what was decided, decided again from the logs
  path-handoff view runs/20261104-101500      the scene, both images, plots, words, in Rerun
  path-handoff fly mission.py --rig sim       a mission of your own (docs/own-missions.md)
  path-handoff doctor --rig my-rig.toml       is everything there, before anything moves?
  path-handoff prepare --rig my-rig.toml      compile its kernels now, so that no later start does
  path-handoff sender --rig my-rig.toml       one drone's side, as in the field
  path-handoff calibrate camera --images views --out d1.camera.toml
  path-handoff detect film.mp4 --model yolox.onnx --classes car
  path-handoff guard --rig my-rig.toml        beside it: holds and lands when the script does not
  path-handoff trial sensitivity              an experiment of the paper, run again
  path-handoff verify                         whatever the link does: never two responsible
  path-handoff campaign --runs 10000          thousands of hand-overs under faults, by seed
  path-handoff conformance --px4 PATH         where the embedded vehicle differs from a real autopilot
"""

Command = (
    Annotated[HandoffOptions, tyro.conf.subcommand("handoff")]
    | Annotated[RelayOptions, tyro.conf.subcommand("relay")]
    | Annotated[TeamOptions, tyro.conf.subcommand("team")]
    | Annotated[FlyOptions, tyro.conf.subcommand("fly")]
    | Annotated[SenderOptions, tyro.conf.subcommand("sender")]
    | Annotated[ReceiverOptions, tyro.conf.subcommand("receiver")]
    | Annotated[GuardOptions, tyro.conf.subcommand("guard")]
    | Annotated[DoctorOptions, tyro.conf.subcommand("doctor")]
    | Annotated[PrepareOptions, tyro.conf.subcommand("prepare")]
    | Annotated[RigsOptions, tyro.conf.subcommand("rigs")]
    | Annotated[ReportOptions, tyro.conf.subcommand("report")]
    | Annotated[ReplayOptions, tyro.conf.subcommand("replay")]
    | Annotated[ViewOptions, tyro.conf.subcommand("view")]
    | Annotated[MergeOptions, tyro.conf.subcommand("merge")]
    | Annotated[ExportOptions, tyro.conf.subcommand("export")]
    | Annotated[TrialOptions, tyro.conf.subcommand("trial")]
    | Annotated[VerifyOptions, tyro.conf.subcommand("verify")]
    | Annotated[CampaignOptions, tyro.conf.subcommand("campaign")]
    | Annotated[ConformanceOptions, tyro.conf.subcommand("conformance")]
    | Annotated[CalibrateOptions, tyro.conf.subcommand("calibrate")]
    | Annotated[DetectOptions, tyro.conf.subcommand("detect")]
)


def main(arguments: Sequence[str] | None = None) -> None:
    """The console script; ends the process with the command's exit code."""
    _have_streams()
    code = _carry_out(arguments)
    written = [flush_or_drop(stream) for stream in (sys.stdout, sys.stderr)]
    if not all(written) and code == CommandEnd.DONE.exit_code:
        code = CommandEnd.OUTPUT_FAILED.exit_code
    sys.exit(code)


def _have_streams() -> None:
    """A program that is started with a closed stdout or stderr has none: what it says goes nowhere."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_WRONLY), "w"))


def _carry_out(arguments: Sequence[str] | None) -> int:
    """The exit code of a command line. Raises SystemExit for one that was not understood, or asked for help."""
    if (sys.argv[1:] if arguments is None else list(arguments)) == ["--version"]:
        sys.stdout.write(f"path-handoff {version('path-handoff')}\n")
        sys.exit(0)
    try:
        command = tyro.cli(
            Command,  # type: ignore[arg-type]  # a union of options, one for each command
            args=_spelled_out(sys.argv[1:] if arguments is None else arguments),
            prog="path-handoff",
            description=DESCRIPTION,
            config=(tyro.conf.OmitSubcommandPrefixes,),
        )
        return run(command)
    except KeyboardInterrupt:
        return EXIT_CTRL_C
    except BrokenPipeError:  # as in `path-handoff --help | head`
        drop(sys.stdout)  # what is left is not written at exit either
        return EXIT_BROKEN_PIPE
    except OSError as error:
        if error.errno not in UNWRITTEN:
            raise
        if error.filename is None:
            drop(sys.stdout)
        say_unwritten(error)
        return CommandEnd.OUTPUT_FAILED.exit_code
    except Exception as error:
        from drivers.interfaces import PartError  # noqa: PLC0415 (numpy behind it takes longer than all the rest)

        if not isinstance(error, PartError):
            raise
        with suppress(OSError):
            sys.stderr.write(error_text(str(error), error.remedy))
        return EXIT_REFUSED


def _spelled_out(arguments: Sequence[str]) -> list[str]:
    """``--live`` and ``--gcs`` without an address have the usual one."""
    spelled: list[str] = []
    for word, following in zip(arguments, [*arguments[1:], "--"], strict=True):
        spelled += [word, USUAL[word]] if word in USUAL and following.startswith("--") else [word]
    return spelled


def error_text(what: str, remedy: str) -> str:
    """Returns what went wrong and what to do, as the user sees it."""
    lines = what.replace("\n", "\n       ")
    return f"error: {lines}\n" + (f"  fix: {remedy}\n" if remedy else "")


def run(command: Command) -> int:
    """Carry out a command; returns its exit code. Raises PartError when it is refused."""
    wrong = out_of_bounds(command)
    if wrong:
        from drivers.interfaces import PartError  # noqa: PLC0415

        lines = [f"--{name.replace('_', '-')}: {what}" for name, what in wrong]
        raise PartError("\n".join(lines), "give a number that is within these bounds")
    have_kernel_cache()
    module = importlib.import_module(f"missions.{MODULES[type(command)]}")
    return module.run(command)


if __name__ == "__main__":
    main()
