"""The checks of a rig's ``[world]`` before anything moves."""

from __future__ import annotations

import math

from drivers.rig.parts import Rig
from drivers.rig.tables import Problems, RigError, decode_table
from flight.config import MissionConfig
from hil.world.config import WorldConfig
from hil.world.detector import MEASURED

DRAWN = "sim-rendered"
FROM_GEOMETRY = "sim"
CONFINES = "hil.harness.sitl:SitlHarness"


def check_world(rig: Rig) -> None:
    """Raise RigError for a ``[world]`` that cannot be, or that does not fit the mission's fence."""
    config = decode_table(rig.world, WorldConfig, rig.where("world"))
    fence_m = decode_table(rig.mission, MissionConfig, rig.where("mission")).guard.fence_radius_m
    problems = Problems()
    for key, place in (
        ("sender_home.position_m", config.sender_home.position_m),
        ("receiver_home.position_m", config.receiver_home.position_m),
        ("target.start_m", config.target.start_m),
    ):
        away_m = math.hypot(*place)
        if away_m > fence_m:
            what = f"{away_m:g} m from the origin; mission.guard.fence_radius_m is {fence_m:g} m"
            problems.add(rig.where(f"world.{key}"), what)
    if config.slow is not None and rig.harness != CONFINES:
        what = f"{rig.name} does not fly each role as a process in real time: leave it out, or fly --rig sitl"
        problems.add(rig.where("world.slow"), what)
    kind = config.target.kind
    scene = config.scene.name
    if scene != "plain" and rig.level not in (DRAWN, FROM_GEOMETRY):
        what = f"scenes are drawn at level {DRAWN}, and {rig.name} is of level {rig.level}: leave it out"
        problems.add(rig.where("world.scene"), what)
    if rig.level == FROM_GEOMETRY and config.detector is None and (kind, scene) not in MEASURED:
        known = ", ".join(name for of, name in MEASURED if of == kind)
        what = f"no detector was measured on a {kind} in {scene!r}: state [world.detector], or take one of {known}"
        problems.add(rig.where("world.scene"), what)
    problems.raise_any()


def refuse_slow(rig: Rig) -> None:
    """Raise RigError for a share of a core in a rig that is flown by a harness which confines
    nobody.
    """
    if rig.world.get("slow") is not None:
        raise RigError(
            [f"{rig.where('world.slow')}: {rig.name} confines no program here"],
            "leave it out, or use handoff",
        )
