"""The rigs that come with PATH, and how a rig is loaded for a mission: checked whole before
anything moves.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

from drivers.collector import collector_off
from drivers.interfaces import PartError
from drivers.rig.check import check_rig
from drivers.rig.file import load_rig
from drivers.rig.parts import Rig, import_factory
from drivers.rig.read import find_rig, read_rig
from drivers.rig.tables import Problems, RigError, decode_table
from drivers.rig.toml_text import toml_text
from flight.config import MissionConfig
from flight.plan.checks import check_plan
from flight.plan.complete import complete
from flight.plan.settings import check_settings
from flight.plausible import check_plausible
from missions.ground.rigs import FOLDER
from missions.ground.team_config import checked_team


def load(name_or_path: str, *, world: bool = True) -> Rig:
    """A rig by name or path, with everything in it checked before anything moves. Raises RigError.

    Args:
        world: False for one drone's program, which knows nothing of a world or harness: they are
            not imported.
    """
    rig = complete(load_rig(name_or_path, [FOLDER]))
    problems = Problems()
    for check in (check_settings, partial(check_rig, harness=world), mission_of):
        try:
            with collector_off():  # the parts that the rig names are imported here
                check(rig)
        except RigError as error:
            problems.absorb(error)
    problems.raise_any()
    check_plausible(rig)
    check_plan(rig)
    if rig.team or rig.drones or rig.targets:
        checked_team(rig)
    return rig


def name_of(rig: Rig) -> str:
    """Returns the name that ``--rig`` takes: the rig's own when it comes with PATH, else its
    file.
    """
    return rig.file.stem if rig.file.resolve().parent == FOLDER.resolve() else str(rig.file)


def load_unchecked(name_or_path: str) -> Rig:
    """The same, with nothing checked but which settings it names: nothing of what the rig names is
    imported. Raises RigError.
    """
    rig = load_rig(name_or_path, [FOLDER])
    check_settings(rig)
    return complete(rig)


def whole(name_or_path: str) -> str:
    """Return a rig as the text of one file, with all that it takes of others. Raises RigError."""
    table = read_rig(find_rig(name_or_path, [FOLDER]), [FOLDER])
    return toml_text(table, f"The rig {name_or_path}, whole.")


def mission_of(rig: Rig) -> MissionConfig:
    """The rig's ``[mission]``. Raises RigError."""
    return decode_table(rig.mission, MissionConfig, rig.where("mission"))


def trial_part(rig: Rig, name: str) -> Any:
    """The factory that the rig's ``[trials]`` table names for ``name``. Raises PartError when it
    names none.
    """
    if name not in rig.trials:
        raise PartError(
            f"{rig.where('trials')}: missing key '{name}'",
            "trials need a rig whose harness knows the truth, such as sim-rendered",
        )
    return import_factory(rig.trials[name], rig.where(f"trials.{name}"))


def shorter(rig: Rig) -> Rig:
    """The rig for many flights: what comes after the hand-over is not what they try."""
    return replace(rig, mission={**rig.mission, "follow_after_s": 2.0})
