"""What a mission's settings have both drones fly: the facts with the geometry that follows, and what
a check says of it.
"""

from __future__ import annotations

from dataclasses import replace

from flight.config import MissionConfig
from flight.plan.facts import Facts
from flight.plan.geometry import Floats, Layout, followed_at, layout
from flight.rendezvous.viewpoint import Viewpoint
from path.values import frozen


@frozen
class Problem:
    """Something that this rig cannot do. ``change``: the smallest that would do, "" when none was
    found.
    """

    where: str
    what: str
    change: str = ""

    def __str__(self) -> str:
        return f"{self.what}; {self.change}" if self.change else self.what


@frozen
class Flown:
    """The facts and the geometry that a mission's settings have both drones fly."""

    facts: Facts
    mission: MissionConfig
    placed: Layout

    @property
    def range_m(self) -> float:
        """Return the distance from D1's camera to the target."""
        return self.placed.range_m


def flown(facts: Facts, mission: MissionConfig) -> Flown:
    """Work out the geometry that a mission's settings lead to."""
    return at(facts, mission, followed_at(mission))


def at(facts: Facts, mission: MissionConfig, target_h: Floats) -> Flown:
    return Flown(facts, mission, placed(facts, mission, target_h))


def along(of: Flown, share: float) -> Floats:
    """Return a place on the line from D1 to the target, so many times as far."""
    return share * of.placed.target_h


def placed(
    facts: Facts,
    mission: MissionConfig,
    target_h: Floats,
    *,
    share: float = 1.0,
    tilt_h: Floats | None = None,
) -> Layout:
    """Plan D2's viewpoint. ``share``: of the margin to the image's border that is asked for."""
    rendezvous = mission.rendezvous
    margin_px = share * rendezvous.image_margin_px
    return layout(
        facts,
        target_h,
        mission.target.half_size_m,
        mission.separation,
        replace(rendezvous, image_margin_px=margin_px),
        tilt_h=tilt_h,
    )


def has_viewpoint(of: Flown) -> bool:
    return isinstance(placed(of.facts, of.mission, of.placed.target_h).viewpoint, Viewpoint)
