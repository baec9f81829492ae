"""The needs of a team's targets: those that nobody has, and those whose drone has asked for its
relief.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from flight.harness.fleet import TeamConfig
from flight.harness.relay import Pointed
from missions.fly.team.assignment import Need
from missions.fly.team.roster import TeamTarget

CLUTTER_M = 10.0


def needs_of(
    targets: Sequence[TeamTarget],
    now_s: float,
    config: TeamConfig,
    point_at: Callable[[int], Pointed],
) -> list[Need]:
    """Of the targets that are known and that no drone is on its way to. ``point_at``: where a lost
    one is seen.
    """
    needs = list[Need]()
    for target in targets:
        if not target.known or target.leg is not None or target.finder is not None:
            continue
        if target.holder is not None:
            if target.asking is None or target.asking[1] - now_s < config.least_s:
                continue
            needs.append(_need(target, targets, target.heading_deg, target.asking[1] - now_s))
        elif now_s - target.lost_s >= config.point_s:
            north, east, _ = point_at(target.number).place_n_m
            target.place_n_m = north, east, 0.0
            needs.append(_need(target, targets, None, 0.0))
    return needs


def _need(
    target: TeamTarget,
    targets: Sequence[TeamTarget],
    heading_deg: float | None,
    urgent_s: float,
) -> Need:
    others = tuple(
        other.place_m
        for other in targets
        if other is not target
        and other.known
        and math.dist(other.place_m, target.place_m) < CLUTTER_M
    )
    may = frozenset(target.named.drones) or None
    return Need(target.number, target.place_m, heading_deg, others, may, urgent_s)
