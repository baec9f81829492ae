"""``path-handoff trial``: a question of the evaluation or all of them, and the page that shows what
came out.
"""

from __future__ import annotations

import importlib
import json
import shlex
import sys
import traceback
from collections.abc import Sequence
from dataclasses import asdict, replace
from datetime import datetime
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from rich.table import Table
from rich.text import Text

from drivers.interfaces import PartError
from drivers.rig.parts import Rig, with_errors
from flight.command_end import CommandEnd
from flight.outcome import exit_code_of_runs
from missions.ground import rig_library
from missions.ground.options.proofs import TrialOptions
from missions.ground.run_folder import claim_folder, new_folder, unless_refused
from missions.ground.work import Work, open_work
from missions.look.report.command import show
from missions.look.report.records import SUMMARY
from missions.trials.questions import EXPERIMENTS, QUESTIONS, RIG, is_experiment, question_of
from missions.trials.shared.page import PAGE, Chapter, render_page
from missions.trials.shared.trial import (
    TrialFinding,
    TrialRequest,
    TrialResult,
    Verdict,
    trial_part,
)
from path.values import frozen

EXIT_FAILED = CommandEnd.FAILED.exit_code
STYLE: dict[Verdict, str] = {"met": "green", "short": "red", "measured": ""}


@frozen
class Chosen:
    """An experiment that is to be run. ``short``: in its short form, on few samples."""

    name: str
    module: ModuleType
    rig: Rig
    short: bool

    @property
    def title(self) -> str:
        """Return the experiment's own title."""
        return str(self.module.TITLE)

    def check(self) -> None:
        """Raise PartError for a rig that lacks what the experiment needs."""
        for part in getattr(self.module, "NEEDS", ()):
            trial_part(self.rig, part)
        further = getattr(self.module, "check", None)
        if further is not None:
            further(self.rig)


def run(options: TrialOptions) -> int:
    """``path-handoff trial``; 0 when every experiment came to its end, whatever it found but
    violated monitors.

    Raises:
        PartError: for what was asked wrongly, before anything is flown. Of several experiments one
            that fails later is shown on the page, and the rest run.
    """
    _check_files(options)
    chosen = choose(options)
    _check_needs(chosen)
    if is_experiment(options.name):
        sys.stdout.write(
            f"{options.name} is a part of a question now: {command(options, chosen[0].name)}\n"
        )
    sys.stdout.write(needs_told(options, chosen))
    folder_name = options.out or Path("trials") / f"{datetime.now():%Y%m%d-%H%M%S}-{options.name}"
    with unless_refused(folder_name) as folder:
        claim_folder(folder, SUMMARY, '"findings"', '"trials"')
        # whose folder it is, from now on
        _write_json(folder / SUMMARY, {"trials": [], "unfinished": True})
        return _run(options, chosen, folder)


def names_of(options: TrialOptions) -> tuple[str, ...]:
    """Return the experiments that are asked for.

    Raises:
        PartError: for one that is no part of the question.
    """
    everything = tuple(EXPERIMENTS)
    names = everything if options.name == "all" else QUESTIONS.get(options.name, (options.name,))
    foreign = [name for name in options.only if name not in names]
    if foreign:
        whose = f"path-handoff trial {question_of(foreign[0])} --only {foreign[0]}"
        raise PartError(f"--only {foreign[0]}: no part of {options.name}", whose)
    only = options.only
    if not only and options.common_view is not None and "common-view" in names:
        only = ("common-view",)
    return tuple(name for name in names if name in only) if only else names


def choose(options: TrialOptions) -> list[Chosen]:
    """Return what is to be run, each with its rig. Raises PartError."""
    names = names_of(options)
    alone = len(names) == 1
    chosen: list[Chosen] = []
    for name in names:
        experiment = EXPERIMENTS[name]
        # Whoever names a rig for many means the one that knows the truth: a team is no pair.
        is_named = options.rig is not None and (alone or experiment.rig == RIG)
        rig_name = options.rig if is_named and options.rig is not None else experiment.rig
        rig = with_errors(rig_library.load(rig_name), options.errors)
        short = options.quick or (options.name == "all" and experiment.short_in_all)
        chosen.append(Chosen(name, importlib.import_module(experiment.module), rig, short))
    return chosen


def needs_told(options: TrialOptions, chosen: Sequence[Chosen]) -> str:
    """Return in words what each experiment flies or draws, what is left out of it, and which are
    short.
    """
    lines: list[str] = []
    for one in chosen:
        experiment = EXPERIMENTS[one.name]
        given = {
            "xfeat": options.xfeat,
            "set": options.set,
            "common_view": options.common_view,
        }
        lacks = experiment.without and not any(given.get(option) for option in experiment.options)
        left_out = f"; without {experiment.without}" if lacks else ""
        short = "; in its short form" if one.short else ""
        lines.append(f"{one.name:<12} rig {rig_library.name_of(one.rig)}{left_out}{short}\n")
    return "".join(lines)


def _check_needs(chosen: Sequence[Chosen]) -> None:
    """Tell what cannot be run with its rig. Raises PartError when that is all of it."""
    refused: list[PartError] = []
    for one in chosen:
        try:
            one.check()
        except PartError as error:
            refused.append(error)
            sys.stderr.write(f"{one.name} cannot be run: {error}\n" if len(chosen) > 1 else "")
    if len(refused) == len(chosen):
        raise refused[0]


def _check_files(options: TrialOptions) -> None:
    """Raise PartError for a file that is named and not there."""
    files = (("--xfeat", options.xfeat), *(("--set", file) for file in sets_of(options)))
    for option, file in files:
        if file is not None and not file.is_file():
            raise PartError(
                f"{option} {file}: no such file", f"name a file that exists, or leave {option} out"
            )


def _run(options: TrialOptions, chosen: Sequence[Chosen], folder: Path) -> int:
    several = len(chosen) > 1
    chapters: list[Chapter] = []
    with open_work(options.jobs, sys.stdout) as work:
        for number, one in enumerate(chosen, 1):
            which = f"[{number}/{len(chosen)}] " if several else ""
            sys.stdout.write(f"\n{which}{one.title}\n")
            sys.stdout.flush()
            own = new_folder(folder / one.name) if several else folder
            chapters.append(_chapter(options, one, own, work, several))
            # After each one: whoever stops a long run keeps the page of what was done.
            (folder / PAGE).write_text(render_page(chapters, len(chosen)), "utf-8")
    if several:
        _write_json(folder / SUMMARY, _overview(options, chapters))
    each = ", and a folder for each experiment" if several else ""
    sys.stdout.write(f"\n{folder}: {PAGE}, {SUMMARY}{each}\n")
    return exit_code([chapter.result for chapter in chapters])


def _chapter(
    options: TrialOptions, one: Chosen, folder: Path, work: Work, several: bool
) -> Chapter:
    """Run one experiment. What goes wrong in one of several is told, and kept for the page."""
    request = TrialRequest(
        one.rig, folder, options.seed, one.short, work, options.xfeat, options.logs, options.seconds,
        sets_of(options), options.photographs, options.method, options.common_view,
    )  # fmt: skip
    begun = datetime.now()
    result: TrialResult | None = None
    error = ""
    try:
        one.check()
        result = one.module.run(request)
    except Exception as failure:
        if not several:
            raise
        error = str(failure) if isinstance(failure, PartError) else traceback.format_exc()
        sys.stderr.write(f"trial {one.name} failed: {error}\n")
    wall_s = (datetime.now() - begun).total_seconds()
    if result is not None:
        if one.short:
            result = short_form(result)
        _write_json(folder / SUMMARY, _summary(options, one, wall_s, result))
        show(findings_table(result.findings), sys.stdout)
        if one.short:
            sys.stdout.write(f"{SHORT}\n")
    paper = str(one.module.PAPER)
    return Chapter(
        one.name, one.title, paper, command(options, one.name), folder, wall_s, result, error
    )


SHORT = "Short form, on few samples: it says whether the trial runs, and nothing of what comes out."


def short_form(result: TrialResult) -> TrialResult:
    """Return a result as ``--quick`` shows it: no goal is met or missed on a few samples."""
    measured = tuple(replace(finding, verdict="measured") for finding in result.findings)
    return replace(result, findings=measured, notes=(SHORT, *result.notes))


def exit_code(results: Sequence[TrialResult | None]) -> int:
    """0 when every trial came to its end and no monitor of a mission was violated in any."""
    violated = {name for result in results if result is not None for name in result.violations}
    return exit_code_of_runs(violated) or (
        EXIT_FAILED if None in results else CommandEnd.DONE.exit_code
    )


def command(options: TrialOptions, name: str) -> str:
    """Return the command line that runs one experiment again as it was run here."""
    words = [
        "path-handoff",
        "trial",
        question_of(name),
        "--only",
        name,
        "--seed",
        str(options.seed),
    ]
    experiment = EXPERIMENTS[name]
    if options.rig is not None and options.rig != experiment.rig:
        words += ["--rig", options.rig]
    if options.quick:
        words.append("--quick")
    if options.errors is not None:
        words += ["--errors", options.errors]
    for option in experiment.options:
        words += _said_of(options, option)
    return shlex.join(words)


def _said_of(options: TrialOptions, option: str) -> list[str]:
    """Return an option of single experiments as it was said; nothing when it was not."""
    if option == "set":
        words = [word for file in sets_of(options) for word in ("--set", str(file))]
        return words + (
            [] if options.photographs is None else ["--photographs", str(options.photographs)]
        )
    value: object = getattr(options, option)
    if not value:
        return []
    return [
        f"--{option.replace('_', '-')}",
        f"{value:g}" if isinstance(value, float) else str(value),
    ]


def sets_of(options: TrialOptions) -> tuple[Path, ...]:
    """Return the files of all ``--set``, which may be given several times and with several files
    each.
    """
    return tuple(file for files in options.set for file in files)


def findings_table(findings: Sequence[TrialFinding]) -> Table:
    """Return the findings beside the paper's figures and the goals."""
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


def _summary(
    options: TrialOptions, one: Chosen, wall_s: float, result: TrialResult
) -> dict[str, Any]:
    return {
        "trial": one.name,
        "title": one.title,
        "command": command(options, one.name),
        "seed": options.seed,
        "quick": one.short,
        "errors": options.errors,
        "wall_s": round(wall_s, 2),
        **result.summary,
        "findings": [asdict(finding) for finding in result.findings],
    }


def _overview(options: TrialOptions, chapters: Sequence[Chapter]) -> dict[str, Any]:
    results = {chapter.name: chapter.result for chapter in chapters}
    findings = [
        finding for result in results.values() if result is not None for finding in result.findings
    ]
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
    """The same in what JSON knows: numpy's numbers and arrays as numbers and lists, what is not
    finite as null.
    """
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value
