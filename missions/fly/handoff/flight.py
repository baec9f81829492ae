"""One flight of both roles in their harness, from a rig to ``run.json``; any mission's programs can
be flown so.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from drivers.interfaces import PartError
from drivers.rig.parts import Rig, ended_by, import_factory, with_errors, with_scene, with_slow
from flight.harness.flights import Emit, FlightReport, FlightRequest, Harness, RoleMain, RoleResult
from flight.outcome import Outcome, violated_outcome
from missions.fly.handoff.right_object import fly_watched
from missions.fly.handoff.served import stand_in
from missions.fly.leg.process import fly_role, load_program
from missions.ground import rig_library
from missions.ground.lateness import for_lateness
from missions.ground.run_folder import claimed
from missions.ground.shown import FolderGone, say_unwritten
from missions.look.report.advice import advice
from missions.look.report.records import RUN, RunFacts, RunFolderError, write_facts
from path.messages import Role
from path.values import frozen

IN_PROCESS = ("sim", "sim-rendered")
"""Levels at which both roles fly in this process."""
_A_HARNESS = "write one as the rigs of `path-handoff rigs` do, or leave it out"
_CONSEQUENCES = frozenset({Outcome.PEER_LOST, Outcome.PEER_ABORTED})


def rig_as_asked(
    rig: str,
    errors: str | None,
    scene: str | None,
    slow: float | None,
) -> Rig:
    """The rig of this name or file with what was asked for otherwise. Raises PartError."""
    return with_slow(with_scene(with_errors(rig_library.load(rig), errors), scene), slow)


def harness_of(rig: Rig) -> Harness:
    """The harness a rig names. Raises PartError when it names none: then each role is started on
    its own drone.
    """
    if rig.harness is None:
        named = rig_library.name_of(rig)
        raise PartError(
            f"rig {rig.name} is flown from its drones: it has no harness",
            f"start `path-handoff sender --rig {named}` on D1 and `path-handoff receiver --rig {named}` on D2",
        )
    kind = import_factory(rig.harness, rig.where("harness"))
    try:
        harness = kind()
    except SystemExit as error:
        raise PartError(
            f"{rig.where('harness')}: {rig.harness} cannot be made: it {ended_by(error)}",
            _A_HARNESS,
        ) from error
    except TypeError as error:
        raise PartError(
            f"{rig.where('harness')}: {rig.harness} is no harness: {error}", _A_HARNESS
        ) from error
    if not callable(getattr(harness, "fly", None)):
        raise PartError(
            f"{rig.where('harness')}: {rig.harness} is no harness: it has no `fly`", _A_HARNESS
        )
    return harness


@frozen
class FlightPrograms:
    """The programs that both drones fly.

    Attributes:
        main: one role's program, in the harness's process.
        arguments: what ``path-handoff`` is told to fly it in a process of its own, before what all
            such are told.
        good: how both end when all goes well.
        elsewhere: processes of their own are started by a person, in other shells.
        mission: file of a mission of somebody's own; "" for a hand-over.
    """

    main: RoleMain
    arguments: Callable[[Role], Sequence[str]]
    good: Outcome
    elsewhere: bool = False
    mission: str = ""


HANDOFF = FlightPrograms(fly_role, lambda role: (role.value,), Outcome.COMMITTED)


def fly_once(
    rig: Rig,
    seed: int,
    faults: Sequence[str],
    out: Path,
    emit: Emit,
    programs: FlightPrograms = HANDOFF,
) -> RunFacts:
    """One run to its end; writes logs and ``run.json`` into ``out``. Raises PartError for what was
    asked wrongly.
    """
    harness = harness_of(rig)
    if rig.level in IN_PROCESS:
        load_program()  # not while the run's time is measured

    def command(role: Role) -> Sequence[str]:
        if programs.elsewhere:
            return stand_in(rig, role, out)
        return [
            sys.executable, "-m", "missions.cli", *programs.arguments(role), "--rig", str(rig.file), "--out", str(out),
            "--console", "events", "--guard", "expect" if rig.role(role).guard else "none",
        ]  # fmt: skip

    def guard_command(role: Role) -> Sequence[str]:
        return [
            sys.executable, "-m", "missions.cli", "guard", "--rig", str(rig.file), "--role", role.value,
            "--out", str(out), "--console", "events",
        ]  # fmt: skip

    attack = [sys.executable, "-m", "missions.proofs.verify.attack"]
    request = FlightRequest(
        rig,
        out,
        seed,
        tuple(faults),
        programs.main,
        command,
        emit,
        attack,
        guard_command,
    )
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
        mission=programs.mission,
    )
    try:
        if not (out / RUN.marker).exists():
            raise FolderGone.of(out)  # its logs are gone too, whatever is there by now
        write_facts(out, facts)
    except OSError as error:
        say_unwritten(error)
        return unwritten(facts, error)
    return facts


def reported(
    facts: RunFacts,
    folder: Path,
    report: Callable[[], object],
) -> int:
    """Make the report of a run that has been flown; returns the run's exit code, whatever becomes
    of the report.
    """
    if not folder.exists():
        return facts.exit_code  # which was told when the facts could not be written
    try:
        report()
    except OSError as error:
        say_unwritten(error)
        return unwritten(facts, error).exit_code
    except RunFolderError:
        gone = FolderGone.of(folder)  # the logs that were written there are not there
        say_unwritten(gone)
        return unwritten(facts, gone).exit_code
    return facts.exit_code


def unwritten(facts: RunFacts, error: OSError) -> RunFacts:
    """The facts of a run of which something could not be written or shown: a good end then has its
    own outcome.
    """
    if facts.exit_code != 0:
        return facts
    end = Outcome.LOG_FAILED
    detail = f"{error.filename or 'the report'}: {error.strerror or error}"
    return replace(facts, outcome=end.label, exit_code=end.exit_code, detail=detail)


def judge(report: FlightReport, good: Outcome = Outcome.COMMITTED) -> tuple[Outcome, str]:
    """The outcome of the whole run: what a computer that was too slow explains is blamed on nobody
    else.
    """
    absent = [
        end
        for end in report.results.values()
        if end is not None and end.outcome is Outcome.NOT_STARTED
    ]
    # also that the run did not end in time, and the other's end
    explained = bool(absent) and not report.violations
    outcome, detail = _nobody_came(absent) if explained else _cause(report, good)
    return for_lateness(report, outcome, detail)


def _nobody_came(absent: Sequence[RoleResult]) -> tuple[Outcome, str]:
    """The end of a run in which these programs were to be started by a person, and were not."""
    who = "; ".join(f"{end.role.value}: {end.detail}" for end in absent)
    return Outcome.NOT_STARTED, f"{who}. {advice(Outcome.NOT_STARTED.label)}"


def _cause(report: FlightReport, good: Outcome) -> tuple[Outcome, str]:
    """The harness's own failure and violated monitors first, then the roles' causes: of two the one
    that came first.
    """
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
    cause = min(causes, key=lambda end: math.inf if end.ended_s is None else end.ended_s)
    return cause.outcome, f"{cause.role.value}: {cause.detail}"


def _dead(role: Role) -> RoleResult:
    return RoleResult(role, Outcome.CRASHED, "its program died", responsible=False, landed=False)
