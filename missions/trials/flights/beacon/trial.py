"""A whole accuracy session with beacons: flown and recorded, or from the records of one, to errors
by segment.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

from drivers.interfaces import PartError
from drivers.rig.parts import Rig
from missions.ground import rig_library
from missions.ground.run_folder import new_folder
from missions.ground.work import call
from missions.look.report.records import RunRecords, load_run
from missions.look.report.truth import truth_of
from missions.trials.flights.beacon import report
from missions.trials.flights.beacon.session import (
    BeaconSession,
    fly_session,
    load_session,
    record_session,
)
from missions.trials.flights.dynamic.flight import heard_of, reference_of
from missions.trials.flights.dynamic.judge import (
    SessionErrors,
    against_truth,
    measure,
    offset_error_s,
    true_path,
)
from missions.trials.flights.dynamic.pictures import draw_errors, draw_map
from missions.trials.flights.errors import alignments
from missions.trials.shared.trial import TrialRequest, TrialResult, TrialTable

TITLE = "Beacons: one session's trajectories against an ultrasonic reference"
PAPER = "Receiver-View Projection Consistency, dynamic part"
RIG = "dynamic"
QUICK_RIG = "dynamic-sim"
ERRORS = "errors.csv"
FLOWN = "session"  # the folder of a session that is flown here, in the trial's own


def check(rig: Rig) -> None:
    """Raise PartError for a rig without beacons."""
    reference_of(rig)


def run(request: TrialRequest) -> TrialResult:
    rig = request.rig
    if request.quick and rig.name == RIG:
        errors = {key: value for key, value in rig.world.items() if key == "errors"}
        quick = rig_library.load(QUICK_RIG)
        rig = replace(quick, world={**quick.world, **errors})
    if request.logs is not None:
        session = load_session(request.logs)
    elif rig.harness is not None:
        flying = partial(fly_session, rig, request.seed, new_folder(request.out / FLOWN))
        (session,) = request.work.map("session flown", call, [flying])
    else:
        return _recorded(request)
    heard = heard_of(session.fixes, reference_of(rig).mounted)
    flown = load_run(session.folder)
    try:
        measured = measure(flown, heard, rig, request.seed)
    except ValueError as error:
        raise PartError(
            f"{session.folder}: the records of beacons and drones cannot be laid together: {error}",
            "were the beacons of [reference] in the air and rated well, and did D2 see the marker while they moved?",
        ) from error
    rows = report.rows_of(flown, measured, request.seed)
    report.write_errors(request.out / ERRORS, rows)
    error_s = _draw(session, flown, measured, request.out)
    truth = session.truth
    noise = (
        None
        if truth is None
        else TrialTable("What the harness put in", ("what", "value"), truth.noise)
    )
    return TrialResult(
        summary=report.summary(measured, rows, error_s),
        findings=tuple(report.findings(measured, rows, error_s)),
        noise=noise,
        tables=(alignments({session.folder.name: measured}), report.table(rows)),
        pictures={
            "map.png": "From above: left in the beacons' frame, right seen from D1",
            "errors.png": "Errors over time",
        },
        notes=(
            *session.notes,
            "A constant latency of the beacons cannot be told from an offset between the clocks.",
        ),
    )


def _draw(
    session: BeaconSession,
    flown: RunRecords,
    measured: SessionErrors,
    out: Path,
) -> float | None:
    """Draw both pictures; return the error of the clock's offset where it is known."""
    truth = truth_of(flown.world)
    beacons = session.truth
    if truth is None or beacons is None:
        draw_map(measured, out / "map.png")
        draw_errors(measured, out / "errors.png")
        return None
    draw_map(measured, out / "map.png", lambda name, t: true_path(truth, name, beacons, t))
    draw_errors(measured, out / "errors.png", against_truth(flown, truth, measured.motions))
    return offset_error_s(measured, beacons, truth)


def _recorded(request: TrialRequest) -> TrialResult:
    """Records the beacons while the drones are flown from their own computers, in the field."""

    def show(line: str) -> None:
        sys.stdout.write(f"{line}\n")
        sys.stdout.flush()

    show("recording the beacons; Ctrl-C when both drones have landed")
    fixes = record_session(request.rig, request.out, request.seconds, show)
    note = (
        f"Copy sender.mcap and receiver.mcap into {request.out}, then: "
        f"path-handoff trial flights --only beacon --rig {request.rig.file} --logs {request.out}"
    )
    show(note)
    return TrialResult({"positions": len(fixes)}, (), notes=(note,))
