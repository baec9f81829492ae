"""``path-handoff verify``: walk through everything that can happen to the two machines, and catch
every wrong one.
"""

from __future__ import annotations

import sys
from collections import Counter
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import TextIO

from drivers.clock import stopwatch_ns
from flight.command_end import CommandEnd
from missions.ground.options.proofs import VerifyOptions
from missions.ground.run_folder import claim_result, unless_refused, write_json
from missions.ground.work import Work, open_work
from missions.proofs.verify import wire
from missions.proofs.verify.explore import Covering, Exact, Exploration, explore
from missions.proofs.verify.model import Scope
from missions.proofs.verify.mutants import MUTANTS, SMALL, caught
from path.values import frozen

EXIT_BROKEN = CommandEnd.FAILED.exit_code
SUMMARY = "summary.json"
INVARIANTS = ("S1", "S2", "S3", "S4", "S5", "S6", "L1", "L2")


@frozen
class Job:
    """One scope. ``exact``: every world is entered by itself, and not only those that no other
    covers.
    """

    name: str
    scope: Scope
    exact: bool = True


SHORT_TWICE = Scope(lease=3, offer=2, handoff=3, crashes=2, attempts=2)
SHORT_ABORTED = Scope(lease=3, offer=3, handoff=4, crashes=2, aborts=1)
QUICK = (
    Job("the link alone", SMALL),
    Job("one abort", Scope(lease=4, aborts=1)),
    Job("stalls", Scope(lease=4, stalls=True), exact=False),
    Job("one crash", Scope(lease=4, crashes=1), exact=False),
)
SLEEPY = Scope(lease=3, offer=2, handoff=3, stalls=True)
FULL = (  # the longest first, so that no core waits for it at the end
    Job("two crashes, two attempts, a short lease", SHORT_TWICE, exact=False),
    Job("two receivers, stalls", replace(SLEEPY, receivers=2), exact=False),
    Job("two crashes, one abort, a short lease", SHORT_ABORTED, exact=False),
    Job("two crashes", Scope(lease=4, crashes=2), exact=False),
    Job("one crash, two attempts", Scope(lease=4, crashes=1, attempts=2), exact=False),
    Job("two aborts, two attempts", Scope(lease=4, aborts=2, attempts=2), exact=False),
    Job(
        "one crash, clocks that differ twice as much",
        Scope(lease=6, uncertainty=2, crashes=1),
        exact=False,
    ),
    Job("one crash, each world by itself", Scope(lease=4, crashes=1)),
    Job("one crash, one abort", Scope(lease=4, crashes=1, aborts=1), exact=False),
    Job("two attempts", Scope(lease=4, attempts=2)),
    Job("two receivers", replace(SLEEPY, stalls=False, receivers=2), exact=False),
    Job("one crash, stalls", replace(SLEEPY, crashes=1), exact=False),
    Job("two attempts, stalls", replace(SLEEPY, attempts=2), exact=False),
    *QUICK[:3],
)


@frozen
class Explored:
    job: Job
    found: Exploration
    wall_s: float


@frozen
class ModelMutant:
    """The result of a mutant: the invariant it broke, "" when it was not caught, and the worlds
    that took.
    """

    rule: str
    broke: str
    states: int
    wall_s: float


def run(options: VerifyOptions) -> int:
    """Return 0 when nothing is wrong. Raises PartError.

    Then every invariant holds in every world and every mutant was caught, or no forged packet was
    taken.
    """
    with unless_refused(
        options.out or Path("verify") / datetime.now().strftime("%Y%m%d-%H%M%S")
    ) as folder:
        claim_result(folder / SUMMARY, '"holds"')
        return _run(options, folder)


def _run(options: VerifyOptions, folder: Path) -> int:
    if options.wire:
        return _run_wire(options, folder)
    jobs = QUICK if options.quick else FULL
    began = stopwatch_ns()
    with open_work(options.jobs) as work:
        explored, tried = verify(work, jobs)
    wall_s = (stopwatch_ns() - began) * 1e-9
    summary = summarize(explored, tried, wall_s)
    write_json(folder / SUMMARY, summary)
    show(explored, tried, wall_s, sys.stdout)
    sys.stdout.write(f"summary: {folder / SUMMARY}\n")
    return 0 if summary["holds"] else EXIT_BROKEN


def _run_wire(options: VerifyOptions, folder: Path) -> int:
    with open_work(options.jobs) as work:
        figures = wire.summary(wire.fuzz(options.wire, options.seed, work))
    whole = {"holds": wire.sound(figures), "seed": options.seed, **figures}
    write_json(folder / SUMMARY, whole)
    wire.show(figures, sys.stdout)
    sys.stdout.write(f"summary: {folder / SUMMARY}\n")
    return 0 if whole["holds"] else EXIT_BROKEN


def verify(work: Work, jobs: tuple[Job, ...]) -> tuple[list[Explored], list[ModelMutant]]:
    """Scopes and mutants over all cores, the mutants last: they take the least."""
    pieces: list[Job | int] = [*jobs, *range(len(MUTANTS))]
    done = work.map("explored", _piece, pieces)
    return [one for one in done if isinstance(one, Explored)], [
        one for one in done if isinstance(one, ModelMutant)
    ]


def _piece(piece: Job | int) -> Explored | ModelMutant:
    began = stopwatch_ns()
    if isinstance(piece, Job):
        found = explore(piece.scope, seen=Exact() if piece.exact else Covering())
        return Explored(piece, found, (stopwatch_ns() - began) * 1e-9)
    mutant = MUTANTS[piece]
    catch = caught(mutant)
    broke = next(iter(catch.broken)) if catch else ""
    return ModelMutant(
        mutant.rule,
        broke,
        catch.states if catch else 0,
        (stopwatch_ns() - began) * 1e-9,
    )


def summarize(
    explored: list[Explored],
    tried: list[ModelMutant],
    wall_s: float,
) -> dict[str, object]:
    """``summary.json``. ``holds`` says whether all is as it must be."""
    violations: Counter[str] = Counter()
    for one in explored:
        violations.update(one.found.broken)
    caught_of = [one for one in tried if one.broke]
    complete = all(one.found.complete for one in explored)
    return {
        "holds": complete and not violations and len(caught_of) == len(tried),
        "states": sum(one.found.states for one in explored),
        "steps": sum(one.found.steps for one in explored),
        "depth": max(one.found.depth for one in explored),
        "in_flight": max(one.found.in_flight for one in explored),
        "violations": sum(violations.values()),
        "violations_of": {name: violations[name] for name in INVARIANTS},
        "mutants": len(tried),
        "mutants_caught": len(caught_of),
        "wall_s": round(wall_s, 1),
        "scopes": [_of_scope(one) for one in explored],
        "caught": [
            {
                "rule": one.rule,
                "breaks": one.broke or None,
                "states": one.states,
                "wall_s": round(one.wall_s, 2),
            }
            for one in tried
        ],
    }


def _of_scope(one: Explored) -> dict[str, object]:
    scope = one.job.scope
    found = one.found
    return {
        "name": one.job.name,
        "receivers": scope.receivers,
        "stalls": scope.stalls,
        "crashes": scope.crashes,
        "aborts": scope.aborts,
        "attempts": scope.attempts,
        "uncertainty_ticks": scope.uncertainty,
        "lease_ticks": scope.lease,
        "method": "exact" if one.job.exact else "covering",
        "complete": found.complete,
        "states": found.states,
        "steps": found.steps,
        "depth": found.depth,
        "in_flight": found.in_flight,
        "violations": sum(found.broken.values()),
        "violations_of": dict(found.broken),
        "example": list(found.example),
        "wall_s": round(one.wall_s, 1),
    }


def show(
    explored: list[Explored],
    tried: list[ModelMutant],
    wall_s: float,
    stream: TextIO,
) -> None:
    """Tables, and the way to the first violation of each scope."""
    write = stream.write
    write(
        f"\n{'scope':<46}{'states':>10}{'steps':>11}{'depth':>7}{'in flight':>11}{'violations':>12}{'time':>9}\n"
    )
    for one in explored:
        found = one.found
        name = one.job.name + ("" if one.job.exact else " *")
        write(
            f"{name:<46}{found.states:>10,}{found.steps:>11,}{found.depth:>7}{found.in_flight:>11}"
            f"{sum(found.broken.values()):>12,}{one.wall_s:>7.1f} s\n"
        )
    states = sum(one.found.states for one in explored)
    steps = sum(one.found.steps for one in explored)
    write(f"{'all':<46}{states:>10,}{steps:>11,}{'':>30}{wall_s:>7.1f} s\n")
    write(
        "* worlds that no other covers: each stands for all with fewer packets or upsets to come\n\n"
    )
    for one in explored:
        if one.found.broken:
            write(f"VIOLATED: {one.job.name}: {dict(one.found.broken)}; the way to the first:\n")
            for number, step in enumerate(one.found.example, 1):
                write(f"  {number:>3}. {step}\n")
    for one in tried:
        what = f"caught, breaks {one.broke}, {one.states:,} states" if one.broke else "NOT CAUGHT"
        write(f"  {one.rule}: {what}\n")
    write(f"mutants caught: {sum(bool(one.broke) for one in tried)} of {len(tried)}\n")
