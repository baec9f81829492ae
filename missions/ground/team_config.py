"""The checked part of a rig about a relay or a team; and a field laid out for more drones and targets
than a team's rig names.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import cycle, islice

from drivers.interfaces import PartError
from drivers.rig.parts import PartSpec, Rig
from drivers.rig.tables import Problems, RigError, decode_table
from flight.config import MissionConfig
from flight.harness.fleet import (
    NamedDrone,
    NamedTarget,
    Point,
    RelayConfig,
    TeamConfig,
    relay_of_rig,
    team_of_rig,
)

HOMES_M = 3.0  # between two of them
ON_THE_WIRE = ("url", "bind", "sysid", "vehicle_sysid", "host", "serial", "device", "key_file")
HOME_ROW_M = 13.0  # of a field that is laid out: the homes of a target south of it
HOME_STEP_M = 4.0

Found = Iterator[tuple[str, str]]


def relay_of(rig: Rig, drones: int) -> RelayConfig:
    """The rig's relay with its first ``drones`` drones. Raises PartError."""
    if not rig.relay:
        raise PartError(
            f"rig {rig.name} has no [relay]",
            "use --rig relay, or a rig like it (docs/relay.md)",
        )
    config = relay_of_rig(rig)
    if not 2 <= drones <= len(config.drones):
        there = f"rig {rig.name} names {len(config.drones)}"
        raise PartError(
            f"--drones {drones}: {there}, and a relay takes two at least",
            "add [[relay.drones]] to the rig",
        )
    return replace(config, drones=config.drones[:drones])


def team_of(
    rig: Rig,
    drones: int | None = None,
    targets: int | None = None,
) -> TeamConfig:
    """The rig's team: all of it, or with so many drones and targets. Raises RigError, and
    PartError.
    """
    config = checked_team(rig)
    if drones is None and targets is None:
        return config
    wanted = drones or len(config.drones)
    objects = targets or len(config.targets)
    if wanted < 2:
        raise PartError(f"--drones {wanted}: a team takes two at least", "give 2 or more")
    if objects > wanted:
        raise PartError(
            f"--targets {objects}: more than the {wanted} drones there are",
            "give fewer targets, or more drones",
        )
    if wanted <= len(config.drones) and objects <= len(config.targets):
        some = replace(config, drones=config.drones[:wanted], targets=config.targets[:objects])
        names = {drone.name for drone in some.drones}
        return replace(
            some,
            targets=tuple(replace(t, drones=tuple(names & set(t.drones))) for t in some.targets),
        )
    return laid_out(config, wanted, objects)


def checked_team(rig: Rig) -> TeamConfig:
    """Raise RigError with everything that is wrong, PartError when the rig has no team."""
    if not rig.team:
        raise PartError(
            f"rig {rig.name} has no [team]", "use --rig team, or a rig like it (docs/team.md)"
        )
    try:
        config = team_of_rig(rig)
    except RigError as error:
        raise RigError([_own_table(line) for line in error.problems], error.remedy) from error
    mission = decode_table(rig.mission, MissionConfig, rig.where("mission"))
    problems = Problems()
    for check in (_homes, _wire, _takers, _heights):
        for where, what in check(config, mission):
            problems.add(rig.where(where), what)
    problems.raise_any()
    return config


def _own_table(line: str) -> str:
    """A problem of ``[[drones]]`` or ``[[targets]]``, which are tables of their own."""
    for table in ("drones", "targets"):
        line = line.replace(f"team.{table}", table).replace(f"team: {table}", table)
    return line


def _homes(config: TeamConfig, mission: MissionConfig) -> Found:
    places: list[tuple[str, NamedDrone]] = []
    for number, drone in enumerate(config.drones):
        for where, other in places:
            if math.dist(drone.home_m, other.home_m) < HOMES_M:
                yield (
                    f"drones[{number}].home_m",
                    f"{_m(drone.home_m)} of {drone.name} is within {HOMES_M:g} m of {where}, {_m(other.home_m)}: "
                    "give each a home of its own",
                )
        places.append((f"drones[{len(places)}].home_m", drone))
    fence_m = mission.guard.fence_radius_m
    named = [(f"drones[{k}].home_m", drone.home_m) for k, drone in enumerate(config.drones)]
    named += [(f"targets[{k}].place_m", target.place_m) for k, target in enumerate(config.targets)]
    for where, place in named:
        if math.hypot(*place) > fence_m:
            yield (
                where,
                f"{_m(place)} is outside of mission.guard.fence_radius_m, {fence_m:g} m: move it, or the fence",
            )


def _wire(config: TeamConfig, mission: MissionConfig) -> Found:
    """Two drones with one port, system id, device or key."""
    del mission
    used: dict[tuple[str, str], tuple[str, str]] = {}
    for number, drone in enumerate(config.drones):
        parts = ((key, getattr(drone, key)) for key in ("vehicle", "guard", "link", "perception"))
        for key, part in parts:
            if not isinstance(part, PartSpec):
                continue
            for option in ON_THE_WIRE:
                value = part.options.get(option)
                if value in (None, ""):
                    continue
                where = f"drones[{number}].{key}.{option}"
                taken = _taken(key, option, value)
                before = used.get(taken)
                if before is not None and before[1] != drone.name:
                    yield (
                        where,
                        f"{value!r} of {drone.name} is already {before[0]}, of {before[1]}: each needs its own",
                    )
                used.setdefault(taken, (where, drone.name))


def _taken(
    part: str,
    option: str,
    value: object,
) -> tuple[str, str]:
    """The port that an option occupies: two listeners on one port collide whatever their addresses
    say.
    """
    text = str(value)
    if option == "bind" or text.startswith(("udpin://", "tcpin://")):
        return "port", text.rpartition(":")[2]
    return (
        "watched"
        if option == "vehicle_sysid"
        else f"{part} {option}"
        if option == "key_file"
        else option
    ), text


def _takers(config: TeamConfig, mission: MissionConfig) -> Found:
    del mission
    names = {drone.name for drone in config.drones}
    if len(config.targets) > len(config.drones):
        count = f"{len(config.targets)} targets for {len(config.drones)} drones"
        yield (
            "targets",
            f"{count}: each needs one at all times, so name fewer targets, or more drones",
        )
    for number, target in enumerate(config.targets):
        unknown = sorted(set(target.drones) - names)
        if unknown:
            there = ", ".join(sorted(names))
            yield (
                f"targets[{number}].drones",
                f"there is no drone {', '.join(unknown)}; there are: {there}",
            )
        if len(target.drones) == 1 or (target.drones and not names & set(target.drones)):
            may = f"only {target.drones[0]} may" if len(target.drones) == 1 else "nobody may"
            yield (
                f"targets[{number}].drones",
                f"{may} take {target.name}: name two at least, who relieve each other, or leave it out for all",
            )


def _heights(config: TeamConfig, mission: MissionConfig) -> Found:
    fence_m = mission.guard.fence_height_m
    apart_m = mission.separation.minimum_m + mission.rendezvous.heights_within_m
    below_m = max(
        mission.receiver_take_off_height_m,
        mission.take_off_height_m,
        mission.follow.height_m,
    )
    for key, height_m, under_m in (
        ("out_height_m", config.out_height_m, below_m),
        ("return_height_m", config.return_height_m, config.out_height_m),
    ):
        if height_m + mission.rendezvous.heights_within_m > fence_m:
            yield (
                f"team.{key}",
                f"{height_m:g} m is too near to mission.guard.fence_height_m, {fence_m:g} m",
            )
        if height_m - under_m < apart_m:
            yield (
                f"team.{key}",
                f"{height_m:g} m is less than {apart_m:g} m above {under_m:g} m, where others fly: give more height",
            )


def laid_out(
    config: TeamConfig,
    drones: int,
    targets: int,
) -> TeamConfig:
    """A field of so many, built like those of the rig: targets on a square grid, the homes of each
    south of it.
    """
    across = math.ceil(math.sqrt(targets))
    step_m = config.spacing_m
    middle = (across - 1) / 2.0
    places = [
        ((k % across - middle) * step_m, (k // across - middle) * step_m) for k in range(targets)
    ]
    named = tuple(NamedTarget(f"T{k + 1}", place, 0.0) for k, place in enumerate(places))
    made: list[NamedDrone] = []
    for number, built in enumerate(islice(cycle(config.drones), drones)):
        east, north = places[number % targets]
        row = number // targets
        aside_m = HOME_STEP_M * ((row + 1) // 2) * (1 if row % 2 else -1)
        made.append(
            replace(
                built,
                name=f"D{number + 1}",
                home_m=(east + aside_m, north - HOME_ROW_M),
                battery=1.0,
            )
        )
    return replace(config, drones=tuple(made), targets=named)


def fenced(rig: Rig, config: TeamConfig) -> Rig:
    """The rig with a fence that holds a field that was laid out."""
    mission = decode_table(rig.mission, MissionConfig, rig.where("mission"))
    places: Sequence[Point] = [
        *(d.home_m for d in config.drones),
        *(t.place_m for t in config.targets),
    ]
    needed_m = 15.0 + max(math.hypot(*place) for place in places)
    if needed_m <= mission.guard.fence_radius_m:
        return rig
    guard = {**rig.mission.get("guard", {}), "fence_radius_m": min(1000.0, needed_m)}
    return dataclasses.replace(rig, mission={**rig.mission, "guard": guard})


def _m(place: Point) -> str:
    return f"({place[0]:g}, {place[1]:g}) m"
