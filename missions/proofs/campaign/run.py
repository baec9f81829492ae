"""``path-handoff campaign``: many seeded runs under faults, as resumable JSON lines, and their
table.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drivers.interfaces import PartError
from drivers.rig.parts import with_errors
from flight.command_end import CommandEnd
from flight.outcome import Outcome, exit_code_of_runs
from missions.ground import rig_library
from missions.ground.options.proofs import CampaignOptions
from missions.ground.options.words import LevelName
from missions.ground.run_folder import claim_result, unless_refused, write_json
from missions.ground.work import Work, open_work
from missions.look.report.junit import JUnitCase, write_junit
from missions.proofs.campaign import machine_runs, role_runs, team_runs
from missions.proofs.campaign.levels import LEVELS
from missions.proofs.campaign.results import RunLine, resumable_results
from missions.proofs.campaign.summary import BROKEN, draw_outcomes, summarize, table
from path.values import frozen

if TYPE_CHECKING:
    from missions.proofs.campaign.cluster import ClusterWork

SUMMARY = "summary.json"
PICTURE = "outcomes.png"


@frozen
class RunOrder:
    """Some runs of one campaign, done at a time: ``(level, number)`` each."""

    rig: str
    seed: int
    runs: tuple[tuple[LevelName, int], ...]
    errors: str | None = None
    hours: float | None = None


@frozen
class Kind:
    """One program of the campaign.

    Attributes:
        fly: does an order; a function at module level.
        replay: one run, with its story to the stream and its logs, if it has any, into a folder.
        at_a_time: runs in an order, so that a piece takes about a second.
    """

    fly: Callable[[RunOrder], list[RunLine]]
    replay: Callable[[RunOrder, Path | None], RunLine]
    at_a_time: int


KINDS: dict[str, Kind] = {
    "machines": Kind(machine_runs.fly, machine_runs.replay, 100),
    "roles": Kind(role_runs.fly, role_runs.replay, 1),
    "team": Kind(team_runs.fly, team_runs.replay, 1),
}


def run(options: CampaignOptions) -> int:
    """Return 0 when no invariant was violated in any run. Raises PartError for what was asked
    wrongly.
    """
    levels = options.faults or LEVELS
    with_errors(rig_library.load(options.rig), options.errors)
    if options.only is not None:
        return _replay(options, levels)
    if options.runs < 1:
        raise PartError(
            f"--runs {options.runs}: nothing to do", "give a number of runs, such as --runs 1000"
        )
    began = datetime.now().strftime("%Y%m%d-%H%M%S")
    with unless_refused(options.out or Path("campaigns") / f"{began}-{options.program}") as folder:
        return _fly(options, levels, folder)


def _fly(
    options: CampaignOptions,
    levels: Sequence[LevelName],
    folder: Path,
) -> int:
    asked: dict[str, Any] = {
        "program": options.program,
        "rig": options.rig,
        "seed": options.seed,
        "levels": list(levels),
    }
    if options.errors is not None:
        asked["errors"] = options.errors
    if options.hours is not None:
        asked["hours"] = options.hours
    if options.junit is not None:
        claim_result(options.junit, "<testsuites>")
    kind = KINDS[options.program]
    with resumable_results(folder, asked) as results:
        done = {line.number for line in results.lines}
        left = [number for number in range(options.runs) if number not in done]
        if done:
            sys.stdout.write(f"{folder}: {len(done)} runs are done, {len(left)} are left\n")
        orders = [
            RunOrder(
                options.rig,
                options.seed,
                tuple((levels[number % len(levels)], number) for number in piece),
                options.errors,
                options.hours,
            )
            for piece in _pieces(left, kind.at_a_time)
        ]
        try:
            with _workers(options) as workers:
                for lines in workers.stream(_what(kind.at_a_time), kind.fly, orders):
                    if any(line.outcome == Outcome.INTERRUPTED.label for line in lines):
                        raise KeyboardInterrupt  # a flight in this process took Ctrl-C as its own
                    results.add(lines)
        except KeyboardInterrupt:
            sys.stdout.write(
                f"\n{len(results.lines)} of {options.runs} runs are done and kept in {folder}\n"
            )
            sys.stdout.write(
                "go on with the same command"
                + ("" if options.out else f" and --out {folder}")
                + "\n"
            )
            return CommandEnd.STOPPED.exit_code
        return report(
            options,
            folder,
            [line for line in results.lines if line.number < options.runs],
        )


def report(
    options: CampaignOptions,
    folder: Path,
    lines: Sequence[RunLine],
) -> int:
    """Write and show what came of the runs; return the exit code."""
    command = partial(replay_command, options)
    summary = summarize(options.program, options.seed, lines, command)
    write_json(folder / SUMMARY, summary)
    draw_outcomes(summary, folder / PICTURE)
    if options.junit is not None:
        runs = sorted(lines, key=lambda line: line.number)
        write_junit(
            options.junit,
            f"campaign {options.program}",
            [junit_case(options, line) for line in runs],
        )
    sys.stdout.write(table(summary))
    sys.stdout.write(f"\n{folder}: {SUMMARY}, {PICTURE}, runs.jsonl\n")
    return exit_code_of_runs(summary["violations_of"])


def junit_case(options: CampaignOptions, line: RunLine) -> JUnitCase:
    """A run as a test case: it fails by what it violated."""
    return JUnitCase(
        f"{line.level} {line.number}",
        line.outcome,
        replay_command(options, line),
        line.violations,
    )


def replay_command(options: CampaignOptions, line: RunLine) -> str:
    """One line that shows a run again."""
    rig = "" if options.rig == CampaignOptions().rig else f" --rig {options.rig}"
    errors = "" if options.errors is None else f" --errors {options.errors}"
    errors += "" if options.hours is None else f" --hours {options.hours:g}"
    program = f"--program {options.program}{rig}{errors}"
    return f"path-handoff campaign {program} --faults {line.level} --seed {options.seed} --only {line.number}"


def _replay(options: CampaignOptions, levels: Sequence[LevelName]) -> int:
    assert options.only is not None
    if len(levels) != 1:
        raise PartError(
            "--only shows one run: of which level?",
            f"name it with --faults, one of {', '.join(LEVELS)}",
        )
    order = RunOrder(
        options.rig,
        options.seed,
        ((levels[0], options.only),),
        options.errors,
        options.hours,
    )
    line = KINDS[options.program].replay(order, options.out)
    broken = " and ".join(BROKEN[name] for name in line.broken)
    for what in (*line.violations, *(f"(after {broken}) {one}" for one in line.beyond)):
        sys.stdout.write(f"violated: {what}\n")
    sys.stdout.write(f"outcome: {line.outcome}\n")
    return exit_code_of_runs([what.partition(" ")[0] for what in line.violations])


def _workers(options: CampaignOptions) -> AbstractContextManager[Work | ClusterWork]:
    if options.cluster is None:
        return open_work(options.jobs)
    from missions.proofs.campaign.cluster import open_cluster  # noqa: PLC0415 (an extra that few install)

    return open_cluster(options.cluster)


def _what(at_a_time: int) -> str:
    return "runs" if at_a_time == 1 else f"{at_a_time} runs each"


def _pieces(numbers: Sequence[int], size: int) -> Iterator[Sequence[int]]:
    for first in range(0, len(numbers), size):
        yield numbers[first : first + size]
