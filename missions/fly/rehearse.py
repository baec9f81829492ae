"""``path-handoff rehearse``: fly a rig of the field in the harness as it is, its hardware replaced
behind the drivers.

Cameras, mounts, markers, method, mission and what was measured stay as they are. Vehicles, guards,
links, clocks and what the cameras see are those of a rig that comes with PATH, at the level that is
asked for. The rig that is flown is written beside the run, so that it can be looked at and flown
again.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from drivers.interfaces import PartError
from drivers.rig.parts import Rig
from drivers.rig.read import find_rig, read_rig
from drivers.rig.toml_text import toml_text
from flight.config import MissionConfig
from flight.plan.complete import body_of, room_of
from flight.plan.facts import facts_of
from missions.ground import rig_library
from missions.ground.options.flights import HandoffOptions, RehearseOptions
from missions.ground.rig_library import mission_of
from missions.ground.rigs import FOLDER
from missions.ground.run_folder import unless_refused

OWN = (
    "origin",
    "markers",
    "marker_dictionary",
    "method",
    "mission",
    "target",
    "drone",
    "depth",
    "link",
    "height",
    "site",
)
"""Tables of the rig itself, which say nothing of hardware."""
OWN_OF_A_DRONE = ("camera", "mount")
NOT_REHEARSED = ("needs",)
"""Keys of ``[mission]`` that ask for what only hardware has."""


def run(options: RehearseOptions) -> int:
    """Fly the rehearsal; return its exit code. Raises PartError."""
    from missions.fly.handoff.command import run as fly  # noqa: PLC0415 (it brings the whole harness along)

    rig = rig_library.load_unchecked(options.rig)
    if rig.harness is not None:
        raise PartError(
            f"{rig.name} flies in the harness already", f"path-handoff handoff --rig {options.rig}"
        )
    with unless_refused(options.out) as folder:
        made = folder.with_name(f"{folder.name}.rig.toml")
        made.write_text(
            toml_text(rehearsed(rig, options.level), _COMMENT.format(name=rig.name)), "utf-8"
        )
        sys.stdout.write(f"{made}: what is flown, with the hardware of '{options.level}'\n")
    return fly(
        HandoffOptions(
            rig=str(made),
            seed=options.seed,
            seeds=options.seeds,
            jobs=options.jobs,
            fault=options.fault,
            errors=options.errors,
            out=folder,
        )
    )


_COMMENT = "{name}, as it is flown in the harness. Written by `path-handoff rehearse`."


def rehearsed(rig: Rig, level: str) -> dict[str, Any]:
    """Return the tables of a field rig with the hardware of the rig that is named as a level.
    Raises RigError.
    """
    own = read_rig(rig.file, rig.folders or [FOLDER])
    stand_in = read_rig(find_rig(level, [FOLDER]), [FOLDER])
    made = {**stand_in, **{key: own[key] for key in OWN if key in own}}
    made["name"] = f"{rig.name}-rehearsed"
    made["description"] = f"{rig.name}, with the hardware of {level}"
    mission = {**own.get("mission", {})}
    for key in NOT_REHEARSED:
        mission.pop(key, None)
    made["mission"] = mission
    for role in ("sender", "receiver"):
        kept = {key: _absolute(own[role][key], rig.file.parent) for key in OWN_OF_A_DRONE}
        made[role] = {**stand_in[role], **kept}
    config = mission_of(rig)
    made["world"] = _world(stand_in.get("world", {}), rig, config)
    for unused in ("relay", "team", "drones", "targets", "reference"):
        made.pop(unused, None)
    return made


def _absolute(table: Mapping[str, Any], base: Path) -> dict[str, Any]:
    """Return a table whose files are found from anywhere."""
    made: dict[str, Any] = {}
    for key, value in table.items():
        if isinstance(value, Mapping):
            made[key] = _absolute(value, base)
        else:
            made[key] = str((base / value).resolve()) if key == "calibration" else value
    return made


def _world(
    stand_in: Mapping[str, Any],
    rig: Rig,
    mission: MissionConfig,
) -> dict[str, Any]:
    """Return a world with the homes, the target and the wind that the rig says."""
    facts = facts_of(rig, mission)
    world = {**stand_in}
    target_n_m = mission.target.north_m, mission.target.east_m
    world["target"] = {
        **stand_in.get("target", {}),
        **body_of(facts.target),
        "start_m": [target_n_m[1], target_n_m[0]],
        "speed_mps": min(0.6 * facts.target.max_speed_mps or 0.3, 15.0),
        "radius_m": max(4.0, 12.0 * facts.target.span_m, 6.0 * facts.target.max_speed_mps),
    }
    if facts.target.flies:
        world["target"]["height_m"] = max(0.5, mission.target.height_m)
    world["look_alikes"] = {**stand_in.get("look_alikes", {}), **room_of(facts.target)}
    if rig.site is not None:
        world["wind"] = {
            **stand_in.get("wind", {}),
            "speed_mps": rig.site.wind_mps,
            "gust_mps": rig.site.gust_mps,
        }
    world["sender_home"] = _home(mission.target.home_m, (0.0, 0.0))
    world["receiver_home"] = _home(mission.rendezvous.home_m, (-3.0, 1.5))
    return world


def _home(home_n_m: tuple[float, ...] | None, usual_n_m: tuple[float, float]) -> dict[str, Any]:
    north_m, east_m = home_n_m or usual_n_m
    return {"position_m": [east_m, north_m]}
