"""``path-handoff handoff``: both roles and their world from one terminal, the run folder, and many runs by seed."""

from __future__ import annotations

import json
import os
import shlex
import signal
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drivers.interfaces import PartError
from drivers.rig.check import check_rig
from drivers.rig.parts import Rig, import_factory, with_errors, with_scene, with_slow
from flight.harness.flights import Emit, FlightReport, FlightRequest, Harness, RoleMain, RoleResult
from flight.outcome import Outcome, violated_outcome
from missions import rig_library
from missions.ground_station import name_ground_station
from missions.handoff.served import check_served, tell_commands, waiting_for
from missions.lateness import for_lateness
from missions.leg.process import fly_role, load_program
from missions.live.start import live
from missions.options.flights import FlyOptions, HandoffOptions
from missions.options.proofs import ConformanceOptions
from missions.report.command import make_report, series_table, show, summarize_many
from missions.report.progress import open_console, open_tally
from missions.report.records import RUN, SUMMARY, RunFacts, load_run, write_facts
from missions.report.right_object import fly_watched
from missions.report.summary import summarize
from missions.run_folder import claim_result, claimed, new_folder, refuse_foreign, unless_refused
from missions.shown import say_unwritten
from path.messages import Role

if TYPE_CHECKING:
    from missions.report.junit import JUnitCase

IN_PROCESS = ("sim", "sim-rendered")
"""Levels at which both roles fly in this process."""
_A_HARNESS = "write one as the rigs of `path-handoff rigs` do, or leave it out"
_CONSEQUENCES = frozenset({Outcome.PEER_LOST, Outcome.PEER_ABORTED})


def run(options: HandoffOptions) -> int:
    """``path-handoff handoff``; returns the run's exit code. Raises PartError for what was asked wrongly."""
    name_simulators(options)
    rig = _as_asked(options.rig, options.errors, options.scene, options.slow)
    if options.slow is not None or options.scene is not None:
        check_rig(rig)
    harness_of(rig)
    name_ground_station(rig, options.gcs)
    if options.serve_world:
        check_served(rig, options)
    refuse_too_slow(rig)
    with unless_refused(options.out) as folder:
        if options.seeds > 1:
            if options.live is not None:
                raise PartError("--live shows one flight, and --seeds flies many", "leave one of them out")
            return fly_many(rig, options, folder)
        with live(options.live, folder), open_console(sys.stdout) as console:
            programs = HANDOFF
            if options.serve_world:
                tell_commands(rig, folder)
                programs = replace(HANDOFF, elsewhere=True)
            facts = fly_once(rig, options.seed, options.fault, folder, console.show, programs)
    try:
        make_report(folder, options.picture, sys.stdout)
    except OSError as error:
        facts = unwritten(facts, error)
        say_unwritten(error)
    return facts.exit_code


def refuse_too_slow(rig: Rig) -> None:
    """Raises PartError where the rig's share of this core flies nothing; one without a share is not measured."""
    if rig.world.get("slow") is not None:
        from missions.doctor.computer import refuse_share  # noqa: PLC0415  a flight does without the doctor

        refuse_share(rig, rig.world["slow"])


def name_simulators(options: HandoffOptions | FlyOptions | ConformanceOptions) -> None:
    """Names the programs of real autopilots for the harness and its processes. Raises PartError."""
    for variable, binary in (("PATH_PX4", options.px4), ("PATH_ARDUPILOT", options.ardupilot)):
        if binary is not None:
            if not binary.is_file():
                raise PartError(f"{binary}: no such file", "name the simulator's binary, or leave the option out")
            os.environ[variable] = str(binary.resolve())


def fly_many(rig: Rig, options: HandoffOptions, folder: Path) -> int:
    """Runs with seeds from ``options.seed`` on, each in a folder of its own; 0 when nothing unsafe happened in any.

    A run that ended in a named failure is counted, not an error; a wrong hand-over or a violated monitor is one.
    """
    # one flight does without
    from concurrent.futures import ProcessPoolExecutor, as_completed  # noqa: PLC0415
    from multiprocessing import get_context  # noqa: PLC0415

    from missions.report.junit import write_junit  # noqa: PLC0415

    jobs = 1 if rig.level not in IN_PROCESS else options.jobs or os.cpu_count() or 1
    seeds = range(options.seed, options.seed + options.seeds)
    claim_result(folder / SUMMARY, '"failed_seeds"')
    if options.junit is not None:
        claim_result(options.junit, "<testsuites>")
    for seed in seeds:
        refuse_foreign(_folder_of(folder, seed), RUN)
    summaries: list[dict[str, Any]] = []
    pool = ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=_leave_signals_to_the_parent)
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
        write_junit(options.junit, f"handoff {rig.name}", [junit_case(options, summary) for summary in summaries])
    series = summarize_many(summaries)
    (folder / SUMMARY).write_text(json.dumps(series, indent=2) + "\n", "utf-8")
    show(series_table(series), sys.stdout)
    sys.stdout.write(f"\n{folder}: {SUMMARY}, and a folder for each seed\n")
    return exit_code_of_many(series)


def junit_case(options: HandoffOptions, summary: Mapping[str, Any]) -> JUnitCase:
    """One run of many as a test case: it fails unless it committed."""
    errors = [] if options.errors is None else ["--errors", options.errors]
    scene = [] if options.scene is None else ["--scene", options.scene]
    slow = [] if options.slow is None else ["--slow", f"{options.slow:g}"]
    faults = [word for fault in options.fault for word in ("--fault", fault)]
    asked = ["--rig", options.rig, "--seed", str(summary["seed"]), *errors, *scene, *slow, *faults]
    outcome = str(summary["outcome"])
    failures = () if summary["exit_code"] == 0 else (summary["detail"] or outcome, *summary["notes"])
    from missions.report.junit import JUnitCase  # noqa: PLC0415

    replay = f"path-handoff handoff {shlex.join(asked)}"
    return JUnitCase(f"seed {summary['seed']}", outcome, replay, failures, summary["wall_s"] or 0.0)


def exit_code_of_many(series: Mapping[str, Any]) -> int:
    """0 unless a monitor was violated in one of the runs."""
    return violated_outcome(series["monitors"]).exit_code if series["monitors"] else Outcome.COMMITTED.exit_code


def _leave_signals_to_the_parent() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)


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
    own = new_folder(_folder_of(folder, seed))
    rig = _as_asked(rig_file, errors, scene, slow)
    fly_once(rig, seed, faults, own, lambda _: None)
    summary = summarize(load_run(own))
    (own / SUMMARY).write_text(json.dumps(summary, indent=2) + "\n", "utf-8")
    return summary


def _as_asked(rig: str, errors: str | None, scene: str | None, slow: float | None) -> Rig:
    """The rig of this name or file with what was asked for otherwise. Raises PartError."""
    return with_slow(with_scene(with_errors(rig_library.load(rig), errors), scene), slow)


def harness_of(rig: Rig) -> Harness:
    """The harness a rig names. Raises PartError when it names none: then each role is started on its own drone."""
    if rig.harness is None:
        named = rig_library.name_of(rig)
        raise PartError(
            f"rig {rig.name} is flown from its drones: it has no harness",
            f"start `path-handoff sender --rig {named}` on D1 and `path-handoff receiver --rig {named}` on D2",
        )
    try:
        harness = import_factory(rig.harness, rig.where("harness"))()
    except TypeError as error:
        raise PartError(f"{rig.where('harness')}: {rig.harness} is no harness: {error}", _A_HARNESS) from error
    if not callable(getattr(harness, "fly", None)):
        raise PartError(f"{rig.where('harness')}: {rig.harness} is no harness: it has no `fly`", _A_HARNESS)
    return harness


@dataclass(frozen=True, slots=True)
class FlightPrograms:
    """The programs that both drones fly.

    Attributes:
        main: one role's program, in the harness's process.
        arguments: what ``path-handoff`` is told to fly it in a process of its own, before what all such are told.
        good: how both end when all goes well.
        elsewhere: processes of their own are started by a person, in other shells.
    """

    main: RoleMain
    arguments: Callable[[Role], Sequence[str]]
    good: Outcome
    elsewhere: bool = False


HANDOFF = FlightPrograms(fly_role, lambda role: (role.value,), Outcome.COMMITTED)


def fly_once(
    rig: Rig, seed: int, faults: Sequence[str], out: Path, emit: Emit, programs: FlightPrograms = HANDOFF
) -> RunFacts:
    """One run to its end; writes logs and ``run.json`` into ``out``. Raises PartError for what was asked wrongly."""
    harness = harness_of(rig)
    if rig.level in IN_PROCESS:
        load_program()  # not while the run's time is measured

    def command(role: Role) -> Sequence[str]:
        if programs.elsewhere:
            emit(waiting_for(role, "start it now"))
            return [sys.executable, "-m", "missions.handoff.elsewhere", role.value, str(out)]
        return [
            sys.executable, "-m", "missions.cli", *programs.arguments(role), "--rig", str(rig.file), "--out", str(out),
            "--console", "events", "--guard", "expect" if rig.role(role).guard else "none",
        ]  # fmt: skip

    def guard_command(role: Role) -> Sequence[str]:
        return [
            sys.executable, "-m", "missions.cli", "guard", "--rig", str(rig.file), "--role", role.value,
            "--out", str(out), "--console", "events",
        ]  # fmt: skip

    attack = [sys.executable, "-m", "missions.assurance.verify.attack"]
    request = FlightRequest(rig, out, seed, tuple(faults), programs.main, command, emit, attack, guard_command)
    with claimed(out, RUN):
        report = fly_watched(harness, request)
    outcome, detail = judge(report, programs.good)
    facts = RunFacts(
        rig=rig.name,
        level=rig.level,
        seed=seed,
        outcome=outcome.label,
        exit_code=outcome.exit_code,
        detail=detail,
        faults=tuple(faults),
        simulated_s=round(report.simulated_s, 3),
        wall_s=report.wall_s,
        violations=dict(report.violations),
        notes=tuple(report.notes),
        errors=dict(report.errors),
        scene=report.scene,
        slow=dict(report.slow),
    )
    try:
        write_facts(out, facts)
    except OSError as error:
        say_unwritten(error)
        return unwritten(facts, error)
    return facts


def unwritten(facts: RunFacts, error: OSError) -> RunFacts:
    """The facts of a run of which something could not be written or shown: a good end then has its own outcome."""
    if facts.exit_code != 0:
        return facts
    end, detail = Outcome.LOG_FAILED, f"{error.filename or 'the report'}: {error.strerror or error}"
    return replace(facts, outcome=end.label, exit_code=end.exit_code, detail=detail)


def judge(report: FlightReport, good: Outcome = Outcome.COMMITTED) -> tuple[Outcome, str]:
    """The outcome of the whole run: what a computer that was too slow explains is blamed on nobody else."""
    outcome, detail = _cause(report, good)
    return for_lateness(report.overload, report.violations, outcome, detail)


def _cause(report: FlightReport, good: Outcome) -> tuple[Outcome, str]:
    """The harness's own failure and violated monitors first, then the roles' causes."""
    if report.failure:
        return Outcome.HARNESS_FAILED, report.failure
    if report.violations:
        return violated_outcome(report.violations), "; ".join(report.notes)
    if report.interrupted:
        return Outcome.INTERRUPTED, Outcome.INTERRUPTED.meaning
    results = [_dead(role) if result is None else result for role, result in report.results.items()]
    ends = [result for result in results if result.outcome is not good]
    if not ends:
        if all(report.landed.values()):
            return good, ""
        return Outcome.VEHICLE_REFUSED, "a vehicle did not land"
    # what one drone did because of the other is not the cause
    causes = [end for end in ends if end.outcome not in _CONSEQUENCES] or ends
    cause = causes[0]
    return cause.outcome, f"{cause.role.value}: {cause.detail}"


def _dead(role: Role) -> RoleResult:
    return RoleResult(role, Outcome.CRASHED, "its program died", responsible=False, landed=False)
