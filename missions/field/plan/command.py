"""``path-handoff plan``: show what follows from a rig's facts, predict the hand-over, refuse what
cannot be done.

The derivation itself is ``flight.plan``; here it is put into words and into a picture.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TextIO

from drivers.interfaces import PartError
from flight.command_end import CommandEnd
from flight.plan.checks import problems
from flight.plan.complete import derived_of
from flight.plan.derive import Derived
from flight.plan.facts import facts_of
from flight.plan.flown import Flown, Problem, flown
from flight.plan.predictions import Prediction, predictions
from flight.plausible import implausible
from missions.ground import rig_library
from missions.ground.options.field import PlanOptions
from missions.ground.rig_library import mission_of
from missions.ground.run_folder import write_json


def run(options: PlanOptions, out: TextIO | None = None) -> int:
    """Show the plan of a rig; return NOT_FIT when something in it cannot be done. Raises
    RigError.
    """
    stream = out or sys.stdout
    rig = rig_library.load_unchecked(options.rig)
    mission = mission_of(rig)
    of = flown(facts_of(rig, mission), mission)
    derived = derived_of(rig) if rig.target is not None else ()
    expected = predictions(of)
    planned = tuple(problems(of))
    told = {each.where for each in planned}
    others = tuple(
        Problem(where, what) for where, what in implausible(rig, mission) if where not in told
    )
    wrong = (*planned, *others)

    stream.write(f"{rig.name}: {rig.description or 'no description'}\n")
    _write_derived(derived, stream)
    _write_predictions(expected, stream)
    if options.out is not None:
        _write_files(options.out, of, derived, expected, wrong, stream)
    if not wrong:
        stream.write("\nnothing stands against it\n")
        return CommandEnd.DONE.exit_code
    stream.write("\nwhat cannot be done:\n")
    for problem in wrong:
        stream.write(f"  {problem.where}: {problem.what}\n")
        if problem.change:
            stream.write(f"    smallest change: {problem.change}\n")
    return CommandEnd.NOT_FIT.exit_code


def _write_derived(derived: Sequence[Derived], stream: TextIO) -> None:
    if not derived:
        stream.write(
            "\nIt names its heights and distances itself. With a [target] of its own they would follow from"
            " that (docs/plan.md).\n"
        )
        return
    stream.write("\nderived from [target], [drone], [site], cameras and markers:\n")
    width = max(len(each.key) for each in derived)
    for each in derived:
        value = f"{each.value:g} {each.unit}"
        stream.write(f"  {each.key:<{width}}  {value:<12}  {each.why}\n")


def _write_predictions(expected: Sequence[Prediction], stream: TextIO) -> None:
    stream.write("\nwhat to expect:\n")
    width = max(len(each.what) for each in expected)
    for each in expected:
        stream.write(f"  {each.what:<{width}}  {each.said}\n")


def _write_files(
    folder: Path,
    of: Flown,
    derived: Sequence[Derived],
    expected: Sequence[Prediction],
    wrong: Sequence[Problem],
    stream: TextIO,
) -> None:
    """Write plan.json and plan.png. Raises PartError when they cannot be."""
    from missions.field.plan.picture import draw_plan  # noqa: PLC0415 (matplotlib takes a second)

    record = {
        "derived": {each.key: each.value for each in derived},
        "predicted": {each.key: each.value for each in expected},
        "problems": [
            {"where": each.where, "what": each.what, "change": each.change} for each in wrong
        ],
    }
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_json(folder / "plan.json", record)
        draw_plan(of, folder / "plan.png")
    except OSError as error:
        raise PartError(
            f"--out {folder}: {error.strerror}", "name a folder that can be written"
        ) from error
    stream.write(f"\n{folder}: plan.json, plan.png\n")
