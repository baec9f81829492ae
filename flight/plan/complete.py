"""A rig completed by its plan: what its facts give takes the place of what nobody named.

Called whenever a rig is loaded.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

from drivers.rig.facts import DroneFacts, TargetFacts
from drivers.rig.parts import PartSpec, Rig, RoleRig
from drivers.rig.tables import decode_table
from flight.config import MissionConfig
from flight.plan.derive import Derived, derive, derive_rest
from flight.plan.facts import facts_of
from flight.plan.geometry import flown_layout
from path.config import MethodConfig

DEPTH_KEYS = (
    "min_depth_m",
    "max_depth_m",
    "depth_center_fraction",
    "min_depth_valid",
    "min_depth_pixels",
    "max_depth_spread_m",
    "depth_sigma_at_1m_m",
)
"""Settings of the method that a perception has a copy of."""
LOOK_ALIKES_M = (1.2, 2.0)
"""Of a simulated robot car, to its look-alikes: the least and the most."""
POSITION_SIGMAS = 2.0
"""Of where a drone takes itself to be: how far it keeps from walls for that."""
SPANS_APART = 1.8
"""Times a target's diameter, between it and its look-alikes."""


def complete(rig: Rig) -> Rig:
    """Return the rig with what its facts give filled in. Raises RigError.

    Without ``[target]`` that is what follows from the rates of its cameras, and from how much the
    boxes of both drones overlap.
    """
    rig = replace(rig, method=_measured(rig))
    mission = {**rig.mission}
    method = rig.method
    for each in derived_of(rig):
        table, _, key = each.key.partition(".")
        if table == "mission":
            mission = _with(mission, key, each.value)
        else:
            method = _method_with(method, key, each.value)
    mission = _with_site(mission, rig)
    world = _with_body(rig)
    world = _with_rangefinder(rig, world)
    world = _with_obstacles(rig, world)
    world = _with_drone(rig, world)
    world = _with_detector(rig, world)
    if mission == rig.mission and method == rig.method and world == rig.world and rig.depth is None:
        return rig
    return replace(
        rig,
        mission=mission,
        world=world,
        method=method,
        sender=_with_depth(rig.sender, method),
        receiver=_with_depth(rig.receiver, method),
    )


def _with_site(mission: dict[str, Any], rig: Rig) -> dict[str, Any]:
    """Return the mission with the site's walls and ceiling for its fence, where it names none.

    Walls are kept from by how far a drone wanders, and by twice the standard deviation of its
    position.
    """
    site = rig.site
    if site is None:
        return mission
    drone = rig.drone or DroneFacts()
    has_limits = site.corners_m or site.obstacles or site.unmeasured
    if has_limits and "mission.guard.clear_m" not in rig.named:
        mission = _with(mission, "guard.clear_m", drone.hold_m + POSITION_SIGMAS * site.position_m)
    if site.corners_m and "mission.guard.corners_m" not in rig.named:
        mission = _with(mission, "guard.corners_m", site.corners_m)
    if site.obstacles and "mission.guard.obstacles" not in rig.named:
        mission = _with(mission, "guard.obstacles", [asdict(each) for each in site.obstacles])
    if site.unmeasured and "mission.guard.unmeasured" not in rig.named:
        mission = _with(mission, "guard.unmeasured", True)
    if site.ceiling_m is not None and "mission.guard.fence_height_m" not in rig.named:
        mission = _with(mission, "guard.fence_height_m", site.ceiling_m)
    return mission


def _with_body(rig: Rig) -> Mapping[str, Any]:
    """Return a simulated world whose target has the body of the rig's, and room around it, unless
    it says otherwise.
    """
    facts = rig.target
    if facts is None or rig.harness is None:
        return rig.world
    target = {**body_of(facts), **rig.world.get("target", {})}
    look_alikes = {**room_of(facts), **rig.world.get("look_alikes", {})}
    return {**rig.world, "target": target, "look_alikes": look_alikes}


def room_of(target: TargetFacts) -> dict[str, Any]:
    """Return how far look-alikes keep from a simulated target.

    As far as a target's bodies do not hide each other from where it is followed, and no nearer than
    small cars do.
    """
    usual = LOOK_ALIKES_M
    least_m = max(usual[0], SPANS_APART * target.span_m, target.height_m)
    return {
        "min_distance_m": round(least_m, 2),
        "max_distance_m": round(least_m * usual[1] / usual[0], 2),
    }


def _with_rangefinder(rig: Rig, world: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return a simulated world whose drones have the rig's rangefinders, unless it says
    otherwise.
    """
    height = rig.height
    if height is None or rig.harness is None or not height.has_rangefinder:
        return world
    own = {"max_m": height.rangefinder_max_m, "min_m": height.rangefinder_min_m}
    return {**world, "rangefinder": {**own, **world.get("rangefinder", {})}}


def _with_obstacles(rig: Rig, world: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return a simulated world in which the site's obstacles stand."""
    if rig.site is None or not rig.site.obstacles or rig.harness is None:
        return world
    known = [asdict(each) for each in rig.site.obstacles]
    return {**world, "obstacles": {"known": known, **world.get("obstacles", {})}}


def _with_drone(rig: Rig, world: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return a simulated world whose drones weigh what the rig's do, unless it says otherwise."""
    if rig.drone is None or rig.harness is None:
        return world
    keys = ("diameter_m", "mass_kg", "propeller_m", "propellers")
    known = {key: getattr(rig.drone, key) for key in keys}
    own = {key: value for key, value in known.items() if value is not None}
    air = world.get("air", {})
    return {**world, "air": {**air, "drone": {**own, **air.get("drone", {})}}}


def _with_detector(rig: Rig, world: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return a simulated world whose detectors find what the rig's were measured to, unless it says
    otherwise.
    """
    if rig.detector is None or rig.harness is None:
        return world
    rates = rig.detector.rates()
    own: dict[str, Any] = {
        "by_size": [list(each) for each in rates.by_size],
        "false_positives": rates.false_positives,
        "miss_frames": rates.miss_frames,
    }
    return {**world, "detector": {**own, **world.get("detector", {})}}


def body_of(target: TargetFacts) -> dict[str, Any]:
    """Return the body that a simulated target has: of the kind that is nearest in shape, as large
    as stated.
    """
    upright = target.height_m > target.span_m
    kind = "drone" if target.flies else "person" if upright else "car"
    return {"kind": kind, "size_m": [target.length_m, target.width_m, target.height_m]}


def _measured(rig: Rig) -> MethodConfig:
    """Return the method with what the rig says of its depth cameras."""
    depth = rig.depth
    if depth is None:
        return rig.method
    return replace(
        rig.method,
        min_depth_m=depth.min_m,
        max_depth_m=depth.max_m,
        depth_sigma_at_1m_m=depth.sigma_at_1m_m,
    )


def derived_of(rig: Rig) -> tuple[Derived, ...]:
    """Return what a rig's facts give, without what it names itself. Raises RigError."""
    mission = decode_table(rig.mission, MissionConfig, rig.where("mission"))
    facts = facts_of(rig, mission)
    if rig.target is not None:
        return derive(facts, rig.named)
    return derive_rest(facts, rig.named, flown_layout(facts, mission), rig.drone)


def _with(
    table: Mapping[str, Any],
    key: str,
    value: Any,
) -> dict[str, Any]:
    """Return a table with a value at a dotted key."""
    first, _, rest = key.partition(".")
    inner = table.get(first, {})
    return {**table, first: _with(inner, rest, value) if rest else value}


def _method_with(
    method: MethodConfig,
    key: str,
    value: float,
) -> MethodConfig:
    first, _, rest = key.partition(".")
    if rest:
        return replace(method, evidence=replace(method.evidence, **{rest: value}))
    return replace(method, **{first: value})


def _with_depth(own: RoleRig, method: MethodConfig) -> RoleRig:
    """Return a drone whose perception takes depth as the method does, where it does not say
    otherwise.
    """
    options = own.perception.options
    said = options.get("method", {})
    usual = MethodConfig()
    wanted = {key: getattr(method, key) for key in DEPTH_KEYS}
    changed = {key: value for key, value in wanted.items() if value != getattr(usual, key)}
    if not changed:
        return own
    perception = replace(own.perception, options={**options, "method": {**changed, **said}})
    assert isinstance(perception, PartSpec)
    return replace(own, perception=perception)
