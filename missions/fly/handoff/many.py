"""Many handoffs by seed, on all cores: each in a folder of its own, and what came of all."""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from drivers.interfaces import PartError
from drivers.rig.parts import Rig
from flight.outcome import exit_code_of_runs
from missions.fly.handoff.flight import IN_PROCESS, fly_once, rig_as_asked
from missions.ground.options.flights import HandoffOptions
from missions.ground.options.words import MOST_SEED
from missions.ground.run_folder import claim_result, refuse_foreign, unless_refused, write_json
from missions.ground.shown import FolderGone
from missions.ground.work import belong_to_parent
from missions.look.report.command import series_table, show, summarize_many, write_report
from missions.look.report.junit import JUnitCase, write_junit
from missions.look.report.progress import open_tally
from missions.look.report.records import RUN, SUMMARY, RunFolderError
from missions.look.report.series_page import SERIES_PAGE, SERIES_SIGN, write_series_page


def fly_many(
    rig: Rig,
    options: HandoffOptions,
    folder: Path,
) -> int:
    """Run with seeds from ``options.seed`` on, each in a folder of its own; 0 when nothing unsafe
    happened in any.

    A run that ended in a named failure is counted, not an error; a wrong hand-over or a violated
    monitor is one.
    """
    last = options.seed + options.seeds - 1
    if last > MOST_SEED:
        raise PartError(
            f"--seed {options.seed} --seeds {options.seeds}: the last seed would be {last}, the highest is {MOST_SEED}",
            "begin with a lower --seed, or fly fewer",
        )
    jobs = 1 if rig.level not in IN_PROCESS else options.jobs or os.cpu_count() or 1
    seeds = range(options.seed, options.seed + options.seeds)
    claim_result(folder / SUMMARY, '"failed_seeds"')
    claim_result(folder / SERIES_PAGE, SERIES_SIGN)
    if options.junit is not None:
        claim_result(options.junit, "<testsuites>")
    for seed in seeds:
        refuse_foreign(_folder_of(folder, seed), RUN)
    summaries: list[dict[str, Any]] = []
    pool = ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=belong_to_parent)
    try:
        with open_tally(sys.stdout, len(seeds)) as tally:
            asked = str(rig.file), options.errors, options.scene, options.slow
            runs = [pool.submit(_fly_seed, *asked, seed, options.fault, folder) for seed in seeds]
            for done in as_completed(runs):
                summary = done.result()
                summaries.append(summary)
                tally.add(summary["outcome"])
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
    summaries.sort(key=lambda summary: summary["seed"])
    if options.junit is not None:
        write_junit(
            options.junit,
            f"handoff {rig.name}",
            [junit_case(options, summary) for summary in summaries],
        )
    command = f"{_command(options, options.seed)} --seeds {options.seeds}"
    series = summarize_many(summaries, command)
    write_json(folder / SUMMARY, series)
    write_series_page(folder / SERIES_PAGE, series, summaries, command)
    show(series_table(series), sys.stdout)
    sys.stdout.write(f"\n{folder}: {SERIES_PAGE}, {SUMMARY}, and a folder for each seed\n")
    return exit_code_of_runs(series["monitors"])


def junit_case(options: HandoffOptions, summary: Mapping[str, Any]) -> JUnitCase:
    """One run of many as a test case: it fails unless it committed."""
    outcome = str(summary["outcome"])
    failures = (
        () if summary["exit_code"] == 0 else (summary["detail"] or outcome, *summary["notes"])
    )
    replay = _command(options, summary["seed"])
    return JUnitCase(f"seed {summary['seed']}", outcome, replay, failures, summary["wall_s"] or 0.0)


def _command(options: HandoffOptions, seed: int) -> str:
    """The command that flies one of the runs by itself."""
    errors = [] if options.errors is None else ["--errors", options.errors]
    scene = [] if options.scene is None else ["--scene", options.scene]
    slow = [] if options.slow is None else ["--slow", f"{options.slow:g}"]
    model = [] if options.model is None else ["--model", str(options.model)]
    faults = [word for fault in options.fault for word in ("--fault", fault)]
    asked = ["--rig", options.rig, "--seed", str(seed), *errors, *scene, *slow, *model, *faults]
    return f"path-handoff handoff {shlex.join(asked)}"


def _folder_of(folder: Path, seed: int) -> Path:
    return folder / f"seed-{seed:04d}"


def _fly_seed(
    rig_file: str,
    errors: str | None,
    scene: str | None,
    slow: float | None,
    seed: int,
    faults: Sequence[str],
    folder: Path,
) -> dict[str, Any]:
    """One run of many, in a worker process."""
    rig = rig_as_asked(rig_file, errors, scene, slow)
    with unless_refused(_folder_of(folder, seed)) as own:
        fly_once(rig, seed, faults, own, lambda _: None)
        try:
            return write_report(own, picture=False)
        except RunFolderError as error:  # what was flown there is not there
            raise FolderGone.of(own) from error
