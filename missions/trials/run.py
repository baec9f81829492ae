"""``path-handoff trial``: one of the paper's experiments, or all of them, and the page that shows what came out."""

from __future__ import annotations

import importlib
import json
import shlex
import sys
import traceback
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from datetime import datetime
from pathlib import Path
from types import ModuleType
from typing import Any, get_args

import numpy as np
from rich.table import Table
from rich.text import Text

from drivers.interfaces import PartError
from drivers.rig.parts import Rig, with_errors
from flight.command_end import CommandEnd
from flight.outcome import exit_code_of_runs
from missions import rig_library
from missions.options.proofs import TrialName, TrialOptions
from missions.report.command import show
from missions.report.records import SUMMARY
from missions.run_folder import claim_folder, new_folder, unless_refused
from missions.trials.shared.page import PAGE, Chapter, render_page
from missions.trials.shared.trial import TrialFinding, TrialRequest, TrialResult, Verdict, trial_part
from missions.work import open_work

NAMES: tuple[str, ...] = tuple(
    name
    for name in get_args(TrialName)
    if name not in ("all", "processes", "rendezvous", "beacon", "soak", "fleet", "real")
)
"""All that ``all`` runs: ``processes``, ``rendezvous`` and ``soak`` take half an hour each, ``fleet`` a quarter,
``beacon`` is ``dynamic``'s; ``real`` runs when sets are named."""
SHORT_IN_ALL = ("recall",)
"""Of these ``all`` runs the short form, which shows no goal as met; whole they are asked for by name."""
RIG = "sim-rendered"
RIGS = {"beacon": "dynamic", "rendezvous": "sim-field", "soak": "sitl", "fleet": "team-sim"}
EXIT_FAILED = CommandEnd.FAILED.exit_code
STYLE: dict[Verdict, str] = {"met": "green", "short": "red", "measured": ""}


def run(options: TrialOptions) -> int:
    """``path-handoff trial``; 0 when every trial came to its end, whatever it found but violated monitors.

    Raises:
        PartError: for what was asked wrongly. With ``all``, a trial that fails is shown on the page, and the rest run.
    """
    whole = options.name == "all"
    names = (*NAMES, *(("real",) if options.set else ())) if whole else (options.name,)
    trials = {name: importlib.import_module(f"missions.trials.{name}.trial") for name in names}
    rig = with_errors(rig_library.load(options.rig or rig_of(options.name)), options.errors)
    for part in () if whole else getattr(trials[options.name], "NEEDS", ()):
        trial_part(rig, part)
    sets = sets_of(options)
    files = (("--xfeat", options.xfeat), *(("--set", file) for file in sets))
    for option, file in files:
        if file is not None and not file.is_file():
            raise PartError(f"{option} {file}: no such file", f"name a file that exists, or leave {option} out")
    with unless_refused(options.out or Path("trials") / f"{datetime.now():%Y%m%d-%H%M%S}-{options.name}") as folder:
        claim_folder(folder, SUMMARY, '"findings"', '"trials"')
        _write_json(folder / SUMMARY, {"trials": [], "unfinished": True})  # whose folder it is, from now on
        return _run(options, rig, trials, folder)


def _run(options: TrialOptions, rig: Rig, trials: Mapping[str, ModuleType], folder: Path) -> int:
    whole = options.name == "all"
    sets = sets_of(options)
    chapters: list[Chapter] = []
    with open_work(options.jobs, sys.stdout) as work:
        for number, (name, trial) in enumerate(trials.items(), 1):
            own = new_folder(folder / name) if whole else folder
            sys.stdout.write(f"\n{f'[{number}/{len(trials)}] ' if whole else ''}{trial.TITLE}\n")
            sys.stdout.flush()
            request = TrialRequest(
                rig, own, options.seed, options.quick or (whole and name in SHORT_IN_ALL), work, options.xfeat,
                options.logs, options.seconds, sets, options.photographs,
            )  # fmt: skip
            begun, result, error = datetime.now(), None, ""
            try:
                result = trial.run(request)
            except Exception as failure:
                if not whole:
                    raise
                error = str(failure) if isinstance(failure, PartError) else traceback.format_exc()
                sys.stderr.write(f"trial {name} failed: {error}\n")
            wall_s = (datetime.now() - begun).total_seconds()
            if result is not None and options.quick:
                result = short_form(result)
            if result is not None:
                _write_json(own / SUMMARY, _summary(options, name, trial.TITLE, wall_s, result))
                show(findings_table(result.findings), sys.stdout)
                if options.quick:
                    sys.stdout.write(f"{SHORT}\n")
            chapters.append(Chapter(name, trial.TITLE, trial.PAPER, command(options, name), own, wall_s, result, error))
            # after each trial: whoever stops a long run keeps the page of what was done
            (folder / PAGE).write_text(render_page(chapters, len(trials)), "utf-8")
    if whole:
        _write_json(folder / SUMMARY, _overview(options, chapters))
    sys.stdout.write(f"\n{folder}: {PAGE}, {SUMMARY}{', and a folder for each trial' if whole else ''}\n")
    return exit_code([chapter.result for chapter in chapters])


SHORT = "Short form, on few samples: it says whether the trial runs, and nothing of what comes out."


def short_form(result: TrialResult) -> TrialResult:
    """Returns a result as ``--quick`` shows it: no goal is met or missed on a few samples."""
    measured = tuple(replace(finding, verdict="measured") for finding in result.findings)
    return replace(result, findings=measured, notes=(SHORT, *result.notes))


def exit_code(results: Sequence[TrialResult | None]) -> int:
    """0 when every trial came to its end and no monitor of a mission was violated in any."""
    violated = {name for result in results if result is not None for name in result.violations}
    return exit_code_of_runs(violated) or (EXIT_FAILED if None in results else CommandEnd.DONE.exit_code)


def command(options: TrialOptions, name: str) -> str:
    """The command line that runs one trial again as it was run here."""
    words = ["path-handoff", "trial", name, "--seed", str(options.seed)]
    if options.rig is not None and options.rig != rig_of(name):
        words += ["--rig", options.rig]
    if options.quick:
        words.append("--quick")
    if options.errors is not None:
        words += ["--errors", options.errors]
    if options.xfeat is not None and name in ("ambiguity", "compute"):
        words += ["--xfeat", str(options.xfeat)]
    if name == "real":
        words += [word for file in sets_of(options) for word in ("--set", str(file))]
        words += [] if options.photographs is None else ["--photographs", str(options.photographs)]
    if options.seconds:
        words += ["--seconds", f"{options.seconds:g}"]
    if options.logs is not None and name == "beacon":
        words += ["--logs", str(options.logs)]
    return shlex.join(words)


def sets_of(options: TrialOptions) -> tuple[Path, ...]:
    """The files of all ``--set``, which may be given several times and with several files each."""
    return tuple(file for files in options.set for file in files)


def rig_of(name: str) -> str:
    """The rig of a trial when none is named."""
    return RIGS.get(name, RIG)


def findings_table(findings: Sequence[TrialFinding]) -> Table:
    """Returns the findings beside the paper's figures and the goals."""
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="dim")
    for title in ("", "ours", "95 % interval", "paper", "goal", ""):
        table.add_column(title, overflow="fold")
    for finding in findings:
        said = "" if finding.verdict == "measured" else finding.verdict
        table.add_row(
            finding.quantity, finding.ours, finding.interval, finding.paper, finding.goal,
            Text(said, STYLE[finding.verdict]),
        )  # fmt: skip
    return table


def _summary(options: TrialOptions, name: str, title: str, wall_s: float, result: TrialResult) -> dict[str, Any]:
    return {
        "trial": name,
        "title": title,
        "command": command(options, name),
        "seed": options.seed,
        "quick": options.quick,
        "errors": options.errors,
        "wall_s": round(wall_s, 2),
        **result.summary,
        "findings": [asdict(finding) for finding in result.findings],
    }


def _overview(options: TrialOptions, chapters: Sequence[Chapter]) -> dict[str, Any]:
    results = {chapter.name: chapter.result for chapter in chapters}
    findings = [finding for result in results.values() if result is not None for finding in result.findings]
    return {
        "seed": options.seed,
        "quick": options.quick,
        "wall_s": round(sum(chapter.wall_s for chapter in chapters), 1),
        "failed": [name for name, result in results.items() if result is None],
        "met": sum(finding.verdict == "met" for finding in findings),
        "short": [finding.quantity for finding in findings if finding.verdict == "short"],
        "trials": {name: result.summary for name, result in results.items() if result is not None},
    }


def _write_json(file: Path, content: object) -> None:
    file.write_text(json.dumps(plain(content), indent=2, allow_nan=False) + "\n", "utf-8")


def plain(value: Any) -> Any:
    """The same in what JSON knows: numpy's numbers and arrays as numbers and lists, what is not finite as null."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value
