"""The checks that a rig's parts fit together for a mission to be flown as it says, before anything
moves.

Each number by itself has bounds (``path.bounds``). Here they are held against each other: places
and heights against the fence, ranges against the cameras, waits against what they wait for. Whether
the world of a simulated rig fits is for its harness to say.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np

from drivers.rig.parts import Rig, decode_part
from drivers.rig.tables import Problems, RigError, decode_table
from flight.common_view import parts_hz
from flight.config import MissionConfig
from flight.harness.fleet import RelayConfig
from flight.plan.facts import camera_rate_hz, facts_of
from flight.rendezvous.viewpoint import NoViewpoint, ViewpointScene, plan_viewpoint
from path.messages import Candidate, KeyframePart, Message, Ping, Pong, Role, Status, Target

FAST_MPS = 1.0
"""No autopilot is asked to climb or land faster: a wait that is shorter than that ends in the
air.
"""

ROUNDED_M = 1e-6
"""Two heights of a rig are apart by what their difference is, within floating point."""

Found = Iterator[tuple[str, str]]
"""Table and key, and what is wrong with it."""


def check_plausible(rig: Rig) -> None:
    """Raises RigError with everything in a rig's ``[mission]``, ``[method]`` and ``[relay]`` that
    cannot be flown.
    """
    mission = decode_table(rig.mission, MissionConfig, rig.where("mission"))
    problems = Problems()
    for where, what in implausible(rig, mission):
        problems.add(rig.where(where), what)
    if rig.relay:
        try:
            relay = decode_table(rig.relay, RelayConfig, rig.where("relay"), rig.file.parent)
        except RigError as error:
            problems.absorb(error)
        else:
            for where, what in _relay(relay, mission):
                problems.add(rig.where(where), what)
    problems.raise_any()


def implausible(rig: Rig, mission: MissionConfig) -> Found:
    """What a pair with this rig cannot fly, whatever its world is."""
    checks: tuple[Callable[[Rig, MissionConfig], Found], ...] = (
        _origin, _fence, _heights, _ground, _ranges, _viewpoint, _distances, _waits, _ages, _links,
    )  # fmt: skip
    for check in checks:
        yield from check(rig, mission)


def _origin(rig: Rig, mission: MissionConfig) -> Found:
    """The origin is a place that somebody looked up."""
    del mission
    if rig.origin.latitude_deg == 0.0 and rig.origin.longitude_deg == 0.0:
        yield (
            "origin",
            "0, 0 lies in the Gulf of Guinea and is what says that nothing was measured: "
            "name a point near the site, also where positions do not come from GPS",
        )


def _fence(rig: Rig, mission: MissionConfig) -> Found:
    """Everything that is flown to is inside the fence."""
    del rig
    guard = mission.guard
    target = mission.target
    away_m = math.hypot(target.north_m, target.east_m)
    if away_m > guard.fence_radius_m:
        yield (
            "mission.target",
            f"{away_m:g} m from the origin; mission.guard.fence_radius_m is {guard.fence_radius_m:g} m",
        )
    for key, height_m in (
        ("take_off_height_m", mission.take_off_height_m),
        ("receiver_take_off_height_m", mission.receiver_take_off_height_m),
        ("follow.height_m", mission.follow.height_m),
    ):
        if height_m > guard.fence_height_m:
            yield (
                f"mission.{key}",
                f"{height_m:g} m; mission.guard.fence_height_m is {guard.fence_height_m:g} m",
            )


def _heights(rig: Rig, mission: MissionConfig) -> Found:
    """The drones take off to heights that are apart by more than each wanders, and from places that
    are.
    """
    hold_m = facts_of(rig, mission).drone.hold_m
    apart_m = abs(mission.receiver_take_off_height_m - mission.take_off_height_m)
    if apart_m < hold_m - ROUNDED_M:
        least_m = mission.take_off_height_m + mission.separation.minimum_m
        yield (
            "mission.receiver_take_off_height_m",
            f"{apart_m:.2g} m from take_off_height_m, and each drone wanders by {hold_m:g} m: they would fly at one "
            f"height; {least_m:g} m would do",
        )
    sender_m = mission.target.home_m
    receiver_m = mission.rendezvous.home_m
    if sender_m and receiver_m and math.dist(sender_m, receiver_m) < mission.separation.minimum_m:
        yield (
            "mission.rendezvous.home_m",
            f"D2 stands {math.dist(sender_m, receiver_m):.2g} m from D1 (mission.target.home_m); "
            f"mission.separation.minimum_m is {mission.separation.minimum_m:g} m",
        )


def _ground(rig: Rig, mission: MissionConfig) -> Found:
    """A height is told over the target's ground only where the target stands on it."""
    del rig
    if mission.level_ground and mission.target.flies:
        yield (
            "mission.level_ground",
            "a drone cannot tell its height by a target that flies: leave out this or mission.target.flies",
        )


def _ranges(rig: Rig, mission: MissionConfig) -> Found:
    """Checks that the sender's camera sees the target from where it follows it, and can range
    it.
    """
    target_b = _target_from_sender(mission)
    own = rig.sender
    method = rig.method
    x, y, z = own.mount.T_b_c.inverse().apply(target_b).tolist()
    if not own.camera.sees((x, y, z)):
        yield (
            "mission.follow",
            f"from {mission.follow.behind_m:g} m behind and {mission.follow.height_m:g} m above the ground the "
            "sender's camera, mounted as sender.mount.camera says, does not see the target",
        )
    if rig.height is None and not method.min_depth_m <= z <= method.max_depth_m:
        yield (
            "mission.follow",
            f"the target is {z:.2f} m before the sender's camera; depth is trusted within [depth] min_m = "
            f"{method.min_depth_m:g} m and max_m = {method.max_depth_m:g} m; "
            "beyond it a rangefinder would do, as [height] says it, for what is no higher than wide",
        )


def _viewpoint(rig: Rig, mission: MissionConfig) -> Found:
    """Checks that there is a place for the receiver, with these cameras, mounts and markers."""
    T_b_v = rig.sender.mount.T_b_v
    own = rig.receiver
    side_m = max(marker.side_m for marker in rig.layout.markers)
    scene = ViewpointScene(
        _target_from_sender(mission) - T_b_v.t, T_b_v.R[:, 2], side_m, -T_b_v.t,
        target_radius_m=mission.target.half_size_m,
    )  # fmt: skip
    plan = plan_viewpoint(
        scene, own.camera, own.mount.T_b_c, mission.rendezvous, mission.separation
    )
    if isinstance(plan, NoViewpoint):
        yield (
            "mission.rendezvous",
            f"{plan} (places given up, by reason); it follows from both roles' mount, receiver.camera, markers, "
            "mission.follow, mission.separation and mission.rendezvous",
        )


def _distances(rig: Rig, mission: MissionConfig) -> Found:
    """The guard does not end what the plan asks for."""
    del rig
    separation = mission.separation
    stand_off_m = mission.rendezvous.stand_off_m
    if separation.minimum_m >= separation.viewpoint_m:
        yield (
            "mission.separation.minimum_m",
            f"{separation.minimum_m:g} m is not below viewpoint_m = {separation.viewpoint_m:g} m",
        )
    if separation.minimum_m >= stand_off_m:
        yield (
            "mission.rendezvous.stand_off_m",
            f"{stand_off_m:g} m is not above mission.separation.minimum_m = {separation.minimum_m:g} m",
        )


def _waits(rig: Rig, mission: MissionConfig) -> Found:
    """A deadline leaves time for what it bounds."""
    method = rig.method
    deadlines = mission.deadlines
    highest_m = max(
        mission.take_off_height_m, mission.receiver_take_off_height_m, mission.follow.height_m
    )
    hold_s = method.hold_s if method.gate == "count" else method.evidence.min_s
    climb_s = highest_m / FAST_MPS
    descent_s = highest_m / FAST_MPS
    approach_s = mission.rendezvous.stand_off_m / mission.rendezvous.max_speed_mps
    pairs = method.needed_pairs
    rate_hz = min(
        (rate for role in Role if (rate := camera_rate_hz(rig.role(role))) is not None),
        default=math.inf,
    )
    for key, wait_s, least_s, what in (
        ("take_off_s", deadlines.take_off_s, climb_s, f"the climb to {highest_m:g} m takes"),
        ("land_s", deadlines.land_s, descent_s, f"the way down from {highest_m:g} m takes"),
        ("verify_s", deadlines.verify_s, hold_s, "the views have to agree for"),
        (
            "verify_s",
            deadlines.verify_s,
            pairs / rate_hz,
            f"{pairs} pairs at {rate_hz:g} frames a second take",
        ),
        ("approach_s", deadlines.approach_s, approach_s, "the way from the stand-off takes"),
        (
            "receiver_ready_s",
            deadlines.receiver_ready_s,
            climb_s + approach_s,
            "the receiver's way takes",
        ),
        (
            "depart_s",
            deadlines.depart_s,
            mission.depart_m / mission.follow.max_speed_mps,
            "the way off takes",
        ),
    ):
        if wait_s <= least_s:
            yield f"mission.deadlines.{key}", f"{wait_s:g} s; {what} {least_s:.3g} s at least"


def _ages(rig: Rig, mission: MissionConfig) -> Found:
    """Checks that nothing is called lost before its next sign of life is due."""
    guard = mission.guard
    slowest_hz = min(mission.status_hz, mission.receiver_status_hz)
    for key, age_s, every_s, what in (
        ("peer_silence_s", guard.peer_silence_s, 1.0 / slowest_hz, f"Status comes {slowest_hz:g} times a second"),
        ("near_silence_s", guard.near_silence_s, 1.0 / slowest_hz, f"Status comes {slowest_hz:g} times a second"),
        *(
            ("frame_age_s", guard.frame_age_s, 1.0 / rate, f"the {role.value}'s frames come {rate:g} times a second")
            for role in Role if (rate := camera_rate_hz(rig.role(role))) is not None
        ),
    ):  # fmt: skip
        if age_s <= every_s:
            yield f"mission.guard.{key}", f"{age_s:g} s is not longer than {every_s:.3g} s: {what}"
    if guard.near_silence_s > guard.peer_silence_s:
        yield (
            "mission.guard.near_silence_s",
            f"{guard.near_silence_s:g} s is above peer_silence_s = {guard.peer_silence_s:g} s",
        )


def _links(rig: Rig, mission: MissionConfig) -> Found:
    """A radio carries what both drones say while they verify."""
    sender_hz = camera_rate_hz(rig.sender)
    receiver_hz = camera_rate_hz(rig.receiver)
    rates_hz: dict[type[Message], float] = {
        Target: sender_hz or mission.follow_hz,
        Candidate: receiver_hz or mission.follow_hz,
        Status: mission.status_hz + mission.receiver_status_hz,
        Ping: 2.0 * mission.ping_hz,
        Pong: 2.0 * mission.ping_hz,
        KeyframePart: parts_hz() if rig.method.common_view else 0.0,
    }
    for role in Role:
        config = decode_part(rig.role(role).link)[1]
        what = config.shortfall(rates_hz) if hasattr(config, "shortfall") else None
        if what is not None:
            yield f"{role.value}.link", what


def _relay(relay: RelayConfig, mission: MissionConfig) -> Found:
    """Homes and the way home are inside the fence, and the reserve is above what ends a mission."""
    guard = mission.guard
    for number, drone in enumerate(relay.drones):
        away_m = math.hypot(*drone.home_m)
        if away_m > guard.fence_radius_m:
            yield (
                f"relay.drones[{number}].home_m",
                f"{drone.name} stands {away_m:g} m from the origin; mission.guard.fence_radius_m is "
                f"{guard.fence_radius_m:g} m",
            )
    if relay.return_height_m > guard.fence_height_m:
        yield (
            "relay.return_height_m",
            f"{relay.return_height_m:g} m; mission.guard.fence_height_m is {guard.fence_height_m:g} m",
        )


def _target_from_sender(mission: MissionConfig) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """The target in the body (FRD) of a level sender that follows it, m."""
    return np.array(
        [mission.follow.behind_m, 0.0, mission.follow.height_m - mission.target.height_m]
    )
