"""What a rig cannot do, found before anything moves, each with the smallest change that makes it
possible. Pure.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from drivers.rig.parts import Rig
from drivers.rig.tables import Problems, decode_table
from flight.config import MissionConfig
from flight.plan import room, sight
from flight.plan.facts import facts_of
from flight.plan.flown import Flown, Problem, flown

CHECKS: tuple[Callable[[Flown], Problem | None], ...] = (
    sight.target_px,
    sight.fits,
    sight.depth,
    sight.behind,
    sight.viewpoint,
    room.site,
    room.obstacles,
    room.ceiling,
    sight.offset,
    room.wind,
    room.speed,
    room.way_out,
    room.height,
    room.rate,
    sight.latency,
)


def check_plan(rig: Rig) -> None:
    """Raise RigError with everything that a rig's drones cannot do, each with the smallest change
    that would do.
    """
    mission = decode_table(rig.mission, MissionConfig, rig.where("mission"))
    found = Problems()
    for problem in problems(flown(facts_of(rig, mission), mission)):
        found.add(rig.where(problem.where), str(problem))
    found.raise_any()


def problems(of: Flown) -> Iterator[Problem]:
    """Yield everything that cannot be done."""
    for check in CHECKS:
        found = check(of)
        if found is not None:
            yield found
