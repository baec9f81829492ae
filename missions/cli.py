"""``path-handoff``: the commands a person starts. Each imports what it needs, and only then."""

from __future__ import annotations

import errno
import importlib
import os
import sys
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout, suppress
from dataclasses import replace
from functools import reduce
from io import StringIO, TextIOWrapper
from operator import or_
from pathlib import Path
from typing import Annotated, Any

from drivers.collector import collector_off
from flight.command_end import CommandEnd
from missions.ground.kernel_cache import have_kernel_cache, have_temporary_folder
from missions.ground.shown import FolderGone, drop, flush_or_drop, say_unwritten
from path.bounds import out_of_bounds

COMMANDS: dict[str, tuple[str, str]] = {
    "handoff": ("flights:HandoffOptions", "fly.handoff.command"),
    "rehearse": ("flights:RehearseOptions", "fly.rehearse"),
    "designate": ("field:DesignateOptions", "fly.designate"),
    "relay": ("flights:RelayOptions", "fly.fleet.command"),
    "team": ("flights:TeamOptions", "fly.fleet.command"),
    "fly": ("flights:FlyOptions", "fly.own.command"),
    "stand-in": ("flights:StandInOptions", "fly.stand_in"),
    "sender": ("field:SenderOptions", "fly.leg.command"),
    "receiver": ("field:ReceiverOptions", "fly.leg.command"),
    "guard": ("field:GuardOptions", "fly.guard.command"),
    "doctor": ("field:DoctorOptions", "field.doctor.command"),
    "prepare": ("field:PrepareOptions", "field.prepare"),
    "rigs": ("field:RigsOptions", "field.rig_list"),
    "checklist": ("field:ChecklistOptions", "field.checklist.command"),
    "plan": ("field:PlanOptions", "field.plan.command"),
    "report": ("runs:ReportOptions", "look.report.command"),
    "replay": ("runs:ReplayOptions", "look.replay.command"),
    "view": ("runs:ViewOptions", "look.view.command"),
    "merge": ("runs:MergeOptions", "look.logs.merge"),
    "export": ("runs:ExportOptions", "look.logs.export"),
    "trial": ("proofs:TrialOptions", "trials.run"),
    "verify": ("proofs:VerifyOptions", "proofs.verify.run"),
    "campaign": ("proofs:CampaignOptions", "proofs.campaign.run"),
    "conformance": ("proofs:ConformanceOptions", "proofs.conformance.run"),
    "calibrate": ("calibrate:CalibrateOptions", "field.calibrate.run"),
    "detect": ("field:DetectOptions", "field.detect"),
    "pose": ("field:PoseOptions", "field.pose"),
}
"""Each command's options, in ``missions.ground.options``, and the module that has its
``run(options) -> exit code``.
"""

EXIT_REFUSED = CommandEnd.REFUSED.exit_code
MOST_SHOWN = 160
LEAST_COLUMNS = 20
EXIT_CTRL_C = CommandEnd.STOPPED.exit_code
EXIT_BROKEN_PIPE = CommandEnd.READER_GONE.exit_code
USUAL = {"--live": "127.0.0.1:8765", "--gcs": "127.0.0.1:14550"}
WRITTEN = ("out", "junit", "page", "save", "layout")
"""Options that name what is written; a device may be."""
UNWRITTEN = (
    errno.ENOSPC,
    errno.EDQUOT,
    errno.EFBIG,
    errno.EIO,
    errno.EROFS,
    errno.EACCES,
    errno.EPERM,
)
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
  path-handoff stand-in tello                 a Tello, vehicle or camera alone, for programs of your own
  path-handoff rehearse my-rig.toml           fly a field rig in the harness, as it is
  path-handoff plan my-rig.toml               can these drones do it, and how?
  path-handoff checklist my-rig.toml          one page of paper: what its crew does and ticks, in order
  path-handoff doctor --rig my-rig.toml       is everything there, before anything moves?
  path-handoff prepare --rig my-rig.toml      compile its kernels now, so that no later start does
  path-handoff sender --rig my-rig.toml       one drone's side, as in the field
  path-handoff designate --rig my-rig.toml    which object is meant: say it, or answer what D1 asks
  path-handoff calibrate camera --images views --out d1.camera.toml
  path-handoff detect film.mp4 --model yolox.onnx --classes car
  path-handoff pose film.mp4 --camera d1.camera.toml --side-mm 40
  path-handoff guard --rig my-rig.toml        beside it: holds and lands when the script does not
  path-handoff trial pose --only sensitivity              an experiment of the paper, run again
  path-handoff verify                         whatever the link does: never two responsible
  path-handoff campaign --runs 10000          thousands of hand-overs under faults, by seed
  path-handoff conformance --px4 PATH         where the embedded vehicle differs from a real autopilot
"""


def main(arguments: Sequence[str] | None = None) -> None:
    """The console script; ends the process with the command's exit code."""
    _have_streams()
    code = _carry_out(arguments)
    written = [flush_or_drop(stream) for stream in (sys.stdout, sys.stderr)]
    if not all(written) and code == CommandEnd.DONE.exit_code:
        code = CommandEnd.OUTPUT_FAILED.exit_code
    sys.exit(code)


def _have_streams() -> None:
    """Have streams that take whatever is said.

    A program that is started with a closed stdout or stderr has none: what it says goes nowhere.
    One whose locale has no UTF-8 writes what it has no letter for as an escape.
    """
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_WRONLY), "w"))
        elif isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    width = os.environ.get("COLUMNS", "")
    if width.isdecimal() and int(width) < LEAST_COLUMNS:  # tyro never ends in one column
        os.environ["COLUMNS"] = str(LEAST_COLUMNS)


def _carry_out(arguments: Sequence[str] | None) -> int:
    """The exit code of a command line. Raises SystemExit for one that was not understood, or asked
    for help.
    """
    if (sys.argv[1:] if arguments is None else list(arguments)) == ["--version"]:
        from importlib.metadata import version  # noqa: PLC0415 (brings e-mail's parser along)

        sys.stdout.write(f"path-handoff {version('path-handoff')}\n")
        sys.exit(0)
    try:
        _refuse_empty(sys.argv[1:] if arguments is None else arguments)
        return _run_whole(
            _understood(_spelled_out(sys.argv[1:] if arguments is None else arguments))
        )
    except KeyboardInterrupt:
        return EXIT_CTRL_C
    except BrokenPipeError:  # as in `path-handoff --help | head`
        drop(sys.stdout)  # what is left is not written at exit either
        return EXIT_BROKEN_PIPE
    except OSError as error:
        if error.errno == errno.ENAMETOOLONG:
            name = str(error.filename)
            shown = (
                name
                if len(name) <= MOST_SHOWN
                else f"{name[:60]}...{name[-60:]} ({len(name)} characters)"
            )
            with suppress(OSError):
                sys.stderr.write(error_text(f"{shown}: {error.strerror}", "name something shorter"))
            return EXIT_REFUSED
        if error.errno not in UNWRITTEN and not isinstance(error, FolderGone):
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


def _run_whole(command: object) -> int:
    """Carry out a command whose exit code only it decides: no command calls ``sys.exit``, code of a
    rig may.
    """
    try:
        return run(command)
    except SystemExit as error:
        from flight.outcome import Outcome  # noqa: PLC0415 (as below)

        what = f"the program was ended by code that it calls, with sys.exit({error.code!r})"
        with suppress(OSError):
            sys.stderr.write(error_text(what, "look for it in what the rig or the mission names"))
        return Outcome.CRASHED.exit_code


def _refuse_empty(arguments: Sequence[str]) -> None:
    """Raise PartError for a value that is empty: as a path it would be the folder one is in."""
    for before, word in zip(["", *arguments], arguments, strict=False):
        if word and not (word.startswith("--") and word.endswith("=")):
            continue
        from drivers.interfaces import PartError  # noqa: PLC0415

        raise PartError(
            f"{word or before or 'an argument'}: its value is empty",
            "give one, or leave it out; is a variable of the shell unset?",
        )


def _understood(arguments: list[str]) -> object:
    """The options of the command that is asked for. Raises SystemExit when help is, or what it says
    is not understood.

    Only the command that is named is made, which takes half as long. What is not understood is
    told, and help given, by all of them together, which know what else may have been meant.
    """
    import tyro  # noqa: PLC0415 (a second on a busy computer, in which Ctrl-C is to end in silence)

    known = (tyro.conf.OmitSubcommandPrefixes,)
    name = arguments[0] if arguments else ""
    if name in COMMANDS:
        with suppress(SystemExit), redirect_stdout(StringIO()), redirect_stderr(StringIO()):
            return tyro.cli(_options_of(name), args=arguments[1:], config=known)
    every: Any = reduce(
        or_, (Annotated[_options_of(name), tyro.conf.subcommand(name)] for name in COMMANDS)
    )
    return tyro.cli(
        every, args=arguments, prog="path-handoff", description=DESCRIPTION, config=known
    )


def _options_of(name: str) -> Any:
    module, _, options = COMMANDS[name][0].partition(":")
    return getattr(importlib.import_module(f"missions.ground.options.{module}"), options)


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


def run(command: object) -> int:
    """Carry out a command; returns its exit code. Raises PartError when it is refused."""
    wrong = out_of_bounds(command)
    if wrong:
        from drivers.interfaces import PartError  # noqa: PLC0415

        lines = [f"--{name.replace('_', '-')}: {what}" for name, what in wrong]
        raise PartError("\n".join(lines), "give a number that is within these bounds")
    _refuse_endless(command)
    command = _with_rig(command)
    have_temporary_folder()
    have_kernel_cache()
    of = {options.partition(":")[2]: module for options, module in COMMANDS.values()}
    # of cycles: a module's classes and functions are kept, and are walked for nothing
    with collector_off():
        module = importlib.import_module(f"missions.{of[type(command).__name__]}")
    return module.run(command)


def _with_rig(command: Any) -> object:
    """Return the command with its rig under one name, instead of a name and options beside it.
    Raises PartError for options beside a rig's file, which says these things itself.

    A name that says options is understood as before, and the options are told.
    """
    from missions.ground.options.words import RigChoice  # noqa: PLC0415

    if not isinstance(command, RigChoice):
        return command
    name: str = command.rig  # type: ignore[attr-defined]
    given = command.level or command.autopilot or command.light
    if name.endswith(".toml") or os.sep in name:
        if given:
            from drivers.interfaces import PartError  # noqa: PLC0415

            raise PartError(
                f"{name} says its level, its autopilot and its pictures itself",
                f"leave out --level, --autopilot and --light; `path-handoff rehearse {name} "
                "--level sim` flies a rig of the field in the harness",
            )
        return command
    from drivers.rig.choice import LEVELS, Choice  # noqa: PLC0415

    asked = Choice.of(name)
    if given:
        asked = asked.but_for(command.level, command.autopilot, command.light)
        return replace(command, rig=asked.name, level=None, autopilot=None, light=False)
    if asked.level and asked.name not in LEVELS:
        sys.stderr.write(f"rig {name}: it is called {asked.options} now\n")
    return command


def _refuse_endless(command: object) -> None:
    """Raise PartError for a pipe or a device that is to be read: it may have no end, or never give
    a byte.
    """
    for name in getattr(command, "__dataclass_fields__", {}):
        given = getattr(command, name)
        if hasattr(given, "__dataclass_fields__"):
            _refuse_endless(given)
        for path in given if isinstance(given, tuple) else (given,):
            if name not in WRITTEN and isinstance(path, Path) and _is_there(path):
                if path.is_file() or path.is_dir():
                    continue
                from drivers.interfaces import PartError  # noqa: PLC0415

                raise PartError(
                    f"{path} is neither a file nor a folder: a pipe or a device",
                    "name a file or a folder",
                )


def _is_there(path: Path) -> bool:
    """Return whether there is something. Raises PartError where this user may not look."""
    try:
        return path.exists()
    except PermissionError as error:
        from drivers.interfaces import PartError  # noqa: PLC0415

        raise PartError(
            f"{path}: {error.strerror}",
            "name something that this user may read, or change its mode",
        ) from error


if __name__ == "__main__":
    main()
