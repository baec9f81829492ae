"""From what was measured to what is flown: heights, distances, times, thresholds. Pure.

Everything follows from the facts, and grows with them: bodies of twice the size are flown round at
twice the distance. What stays as it is has its reason here: ``TILT_RAD`` is an angle, so the
acceleration that it stands for contains gravity; a vehicle's response time is its own.

The range R between D1's camera and the target is the least at which

- the whole target, and what D1 sways by, is inside the image while D1 tilts as much as a correction
  tilts it: (half the box + sway) / R + tan(tilt) <= EDGE * half the image / f, both ways;
- D1's body stays clear of the target: R >= its radius + the least separation;
- there is a viewpoint for D2 (``flight.rendezvous.viewpoint``): R grows until there is.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from drivers.rig.facts import DroneFacts, SiteFacts
from flight.config import Deadlines, GuardConfig, RendezvousConfig, SeparationConfig
from flight.guidance import GRAVITY_MPS2
from flight.plan.errors import TILT_RAD, predict
from flight.plan.facts import Facts
from flight.plan.geometry import (
    Layout,
    apparent,
    boxed_share,
    depression_rad,
    layout,
    place_of_target,
    target_radius_m,
)
from flight.plan.overlap import agreeing_share
from flight.rendezvous.viewpoint import Viewpoint, farthest_m
from flight.wash import keep_out_m, rotors_of, sinks_s
from flight.way_out import LANDING_MPS
from path.config import MethodConfig
from path.values import frozen

HARDEST = 1.1  # times what the target does: to follow it
# times hold_m, within the square of its response: the acceleration that a drone wanders with
WANDERS = 3.0
USUAL_FOCAL_PX = 614.0  # of the camera for which the method's own pixels are
# of a box's longer side: detectors were measured up to 300 (docs/detectors.md)
MOST_TARGET_PX = 280.0
# diameters below a drone: so deep its air is looked at, as deep as viewpoints are
WASH_DEPTHS = (0.0, 0.75, 1.5, 2.25, 3.0)
EDGE = 0.9  # of half the image: what a box keeps from the border
WIDER = 1.05  # the next range to try
MOST_WIDER = 40  # times: seven times the least range
MOST_WAY_OUT_M = 50.0  # before a landing: nobody keeps more room than that (flight.config)

# of the hand-overs: in fewer of them the usual blocks of the gate would be strong enough
AGREEING = 0.85
WEAK_BLOCKS: Mapping[str, float] = {
    "strength": 0.25,
    "first_rate": 0.04,
    "next_rate": 0.45,
    "patient_block_s": 1.0,
    "patient_strength": 0.12,
    "patient_first_rate": 0.07,
    "patient_next_rate": 0.4,
}
"""Of the gate "evidence": measured of micro-UAVs, whose boxes overlap by 0.5 to 0.6."""

Named = Mapping[str, Any]


@frozen
class Derived:
    """One derived value. ``why``: from what it follows; ``limit``: what would break if it were
    less, or more.
    """

    key: str
    value: float
    unit: str
    why: str
    limit: str = ""


COMMON_OFFSET_SHARE = 0.04
COMMON_MOST_SHARE = 0.05
"""Of D1's range: what a pose by common views errs per axis, and the most that it may be said to: as
it was in a drawn flight (docs/common-view.md)."""


def derive(facts: Facts, named: Named) -> tuple[Derived, ...]:
    """Derive all that can be, in the order in which it is used.

    Args:
        named: values that the rig names itself, by dotted key: they are taken as they are, and what
            follows from them.
    """
    found = _Found(named)
    _separation(facts.drone, found)
    _wash(facts.drone, found)
    _following(facts, found)
    _positions(facts, found)
    _rendezvous(facts, found)
    _method(facts, found)
    _waits(found)
    _rates(facts, found)
    return tuple(found.values)


def derive_rest(
    facts: Facts, named: Named, placed: Layout, drone: DroneFacts | None = None
) -> tuple[Derived, ...]:
    """Derive what follows from the rate of frames and from how much the boxes overlap, and from
    drones that are stated, for a rig that says everything else itself.
    """
    found = _Found(named)
    if drone is not None:
        _wash(drone, found)
    if facts.method.common_view:
        usual_m = facts.method.evidence.offset_sigma_m
        offset_m = _offset_by_common_view(usual_m, placed)
        found.add("method.evidence.offset_sigma_m", offset_m, "m", "with a pose by common views")
        _common_view(placed, found)
    _blocks(facts, placed, found)
    _rates(facts, found)
    return tuple(found.values)


def _offset_by_common_view(offset_m: float, placed: Layout) -> float:
    """Return by how much D2's box is off where its pose may be by common views."""
    return math.hypot(offset_m, COMMON_OFFSET_SHARE * placed.range_m)


class _Found:
    """What was derived so far; a value that the rig names stands instead of its own."""

    def __init__(self, named: Named) -> None:
        self._named = named
        self.values: list[Derived] = []

    def add(self, key: str, value: float, unit: str, why: str, limit: str = "") -> float:
        """Note a value, and return what holds: the rig's own where it names one."""
        if key in self._named:
            said = self._named[key]
            return float(said) if isinstance(said, int | float) else value
        rounded = _rounded(value)
        self.values.append(Derived(key, rounded, unit, why, limit))
        return rounded

    def __getitem__(self, key: str) -> float:
        if key in self._named:
            return float(self._named[key])
        return next(each.value for each in self.values if each.key == key)


def _rounded(value: float) -> float:
    """Return a value to four figures: as a person would write it."""
    return float(f"{value:.4g}")


def swing(facts: Facts) -> float:
    """Return how far a drone swings that follows what turns harder than it wanders by itself, in
    m.
    """
    own_mps2 = WANDERS * facts.drone.hold_m / facts.drone.response_s**2
    harder_mps2 = max(0.0, facts.target.max_accel_mps2 - own_mps2)
    return 0.5 * harder_mps2 * facts.drone.response_s**2


def _separation(drone: DroneFacts, found: _Found) -> None:
    """Derive what keeps two drones apart, from their size and from how far they wander."""
    size = "drone.diameter_m"
    hold = "drone.hold_m"
    found.add("mission.separation.horizontal_m", drone.diameter_m, "m", size)
    found.add("mission.separation.vertical_m", 0.75 * drone.diameter_m, "m", size)
    least_m = drone.diameter_m + 0.5 * drone.hold_m
    least_m = found.add("mission.separation.minimum_m", least_m, "m", f"{size}, and half of {hold}")
    apart_m = least_m + 1.75 * drone.hold_m
    found.add("mission.separation.viewpoint_m", apart_m, "m", f"the least, and 1.75 {hold}")
    found.add("mission.separation.marker_m", apart_m, "m", "as between the bodies")


def held_mps2(drone: DroneFacts) -> float:
    """Return the acceleration that a drone holds its place against: what it wanders with anyway, and
    no more than its tilt gives.
    """
    wanders_mps2 = WANDERS * drone.hold_m / drone.response_s**2
    return min(wanders_mps2, GRAVITY_MPS2 * math.tan(math.radians(drone.max_tilt_deg)))


def _wash(drone: DroneFacts, found: _Found) -> None:
    """Derive how far the lower of two drones keeps from the upper one's air.

    The radius at which that pushes as hard as a drone holds grows with the depth, less and less: a
    straight line that is nowhere inside it.
    """
    rotors = rotors_of(drone)
    held = held_mps2(drone)
    depths_m = [share * drone.diameter_m for share in WASH_DEPTHS]
    radii_m = [keep_out_m(rotors, max(depth_m, 0.01), held) for depth_m in depths_m]
    per_m = max(0.0, (radii_m[-1] - radii_m[0]) / depths_m[-1])
    line = (radius_m - per_m * depth_m for radius_m, depth_m in zip(radii_m, depths_m, strict=True))
    least_m = max(line) + 0.5 * drone.hold_m
    why = f"beside air that pushes by {held:.2g} m/s2, by drone.mass_kg and its propellers"
    found.add("mission.separation.wash_m", least_m, "m", why)
    found.add("mission.separation.wash_per_m", per_m, "", "and for each metre below")
    middle_m = 0.5 * depths_m[-1]
    carried = sinks_s(middle_m, rotors.size_m, rotors.hover_mps) / middle_m
    per_slope = math.tan(math.radians(drone.tilt_per_mps_deg))
    lean = 1.0 + carried / per_slope if per_slope > 0.0 else 0.0
    found.add(
        "mission.separation.wash_lean", lean, "", "times a drone's slope in wind, which carries it"
    )


def _following(facts: Facts, found: _Found) -> None:
    """Derive where D1 follows from, and how fast."""
    target = facts.target
    drone = facts.drone
    height_m = 0.0 if target.flies else 0.5 * target.height_m
    height_m = found.add("mission.target.height_m", height_m, "m", "half of target.height_m")
    found.add("mission.target.half_size_m", target_radius_m(facts), "m", "the target as D1 sees it")
    accel_mps2 = max(GRAVITY_MPS2 * math.tan(TILT_RAD), HARDEST * target.max_accel_mps2)
    found.add(
        "mission.max_accel_mps2", accel_mps2, "m/s2", "a tilt of 4.7 deg, or target.max_accel_mps2"
    )
    found.add(
        "mission.follow.target_accel_mps2", target.max_accel_mps2, "m/s2", "target.max_accel_mps2"
    )
    fastest_mps = 1.3 * target.max_speed_mps + 4.0 * drone.hold_m / drone.response_s
    found.add(
        "mission.follow.max_speed_mps",
        min(fastest_mps, drone.max_speed_mps),
        "m/s",
        "1.3 target.max_speed_mps, and to catch up",
        "drone.max_speed_mps",
    )
    found.add(
        "mission.target.fastest_mps", max(target.max_speed_mps, 0.01), "m/s", "target.max_speed_mps"
    )
    found.add("mission.follow.response_s", drone.response_s, "s", "drone.response_s")
    margin_px = facts.receiver.camera.height / 6.0
    found.add("mission.rendezvous.image_margin_px", margin_px, "px", "a sixth of D2's image")
    range_m, why = _range(facts, found)
    angle = depression_rad(facts)
    lever = facts.sender.mount.T_b_c.t
    behind_m = range_m * math.cos(angle) + float(lever[0])
    above_m = range_m * math.sin(angle) + float(lever[2])
    found.add("mission.follow.behind_m", behind_m, "m", f"{range_m:.2f} m along the camera: {why}")
    follow_m = found.add("mission.follow.height_m", height_m + above_m, "m", "the same range")
    found.add("mission.take_off_height_m", follow_m, "m", "as high as D1 follows")
    higher_m = follow_m + found["mission.separation.minimum_m"]
    found.add("mission.receiver_take_off_height_m", higher_m, "m", "the least separation above D1")
    away_m = max(2.5 * found["mission.separation.viewpoint_m"], way_out_m(facts, follow_m))
    found.add(
        "mission.depart_m",
        min(away_m, MOST_WAY_OUT_M),
        "m",
        "out of D2's way, and of the target's",
    )


def way_out_m(facts: Facts, height_m: float) -> float:
    """Return how far aside a drone goes before it lands beside what moves: half of how far that
    gets while the drone comes down, as the way out may be twice as long.
    """
    target = facts.target
    return target.span_m + 0.5 * target.max_speed_mps * height_m / LANDING_MPS


def _positions(facts: Facts, found: _Found) -> None:
    """Derive what positions that are worse than usual are allowed: to D1 of where the target is
    told to be, to D2 of where D1 is.
    """
    position_m = facts.site.position_m
    usual = SiteFacts().position_m
    if position_m <= usual:
        return
    why = "site.position_m"
    found.add("mission.target.own_m", position_m, "m", why)
    worse = position_m / usual
    rendezvous = RendezvousConfig()
    found.add(
        "mission.rendezvous.positions_within_m", worse * rendezvous.positions_within_m, "m", why
    )


def _range(facts: Facts, found: _Found) -> tuple[float, str]:
    """Return the range between D1's camera and the target, and what decides it."""
    fits_m = least_range_m(facts)
    radius_m = found["mission.target.half_size_m"]
    clear_m = radius_m + found["mission.separation.minimum_m"]
    range_m, why = (
        (fits_m, "the target fits the image") if fits_m >= clear_m else (clear_m, "clear of it")
    )
    separation = separation_of(found)
    rendezvous = RendezvousConfig(image_margin_px=found["mission.rendezvous.image_margin_px"])
    for _ in range(MOST_WIDER):
        room = replace(rendezvous, max_range_m=range_m + 2.0 * farthest_m(separation))
        placed = layout(facts, place_of_target(facts, range_m), radius_m, separation, room)
        if isinstance(placed.viewpoint, Viewpoint):
            return range_m, why
        range_m = range_m * WIDER
        why = "D2 sees marker and target from one place"
    return fits_m, "no viewpoint at any range"


def least_range_m(facts: Facts) -> float:
    """Return the least range at which the whole target stays inside D1's image."""
    camera = facts.sender.camera
    seen = apparent(facts, 1.0)
    sway_m = sway(facts)
    half = 0.5 / boxed_share(facts.target)
    ways = (
        (half * seen.width_m + sway_m, 0.5 * camera.width / camera.fx),
        (half * seen.height_m + sway_m, 0.5 * camera.height / camera.fy),
    )
    fits_m = max(size_m / max(1e-3, EDGE * edge - math.tan(TILT_RAD)) for size_m, edge in ways)
    largest_m = max(camera.fx * seen.width_m, camera.fy * seen.height_m) / MOST_TARGET_PX
    return max(fits_m, largest_m)


def sway(facts: Facts) -> float:
    """Return how far D1 is off its place beside a target that turns: what it does within D1's
    response, in m.
    """
    turn_m = 0.5 * facts.target.max_accel_mps2 * facts.drone.response_s**2
    return max(turn_m, facts.drone.hold_m)


def separation_of(found: _Found) -> SeparationConfig:
    """Return the separations that hold."""
    keys = (
        *("horizontal_m", "vertical_m", "viewpoint_m", "marker_m", "minimum_m"),
        *("wash_m", "wash_per_m", "wash_lean"),
    )
    return SeparationConfig(**{key: found[f"mission.separation.{key}"] for key in keys})


def _rendezvous(facts: Facts, found: _Found) -> None:
    """Derive D2's way in."""
    hold_m = facts.drone.hold_m
    separation = separation_of(found)
    range_m = math.hypot(
        found["mission.follow.behind_m"],
        found["mission.follow.height_m"] - found["mission.target.height_m"],
    )
    stand_off_m = separation.viewpoint_m + 3.5 * hold_m
    found.add(
        "mission.rendezvous.stand_off_m", stand_off_m, "m", "the viewpoint, and 3.5 drone.hold_m"
    )
    found.add("mission.rendezvous.clearance_m", 1.5 * hold_m, "m", "1.5 drone.hold_m")
    found.add("mission.rendezvous.stand_off_tolerance_m", 1.25 * hold_m, "m", "1.25 drone.hold_m")
    found.add("mission.rendezvous.search_slide_m", 4.0 * hold_m, "m", "4 drone.hold_m")
    swing_m = 0.3 * swing(facts)
    found.add(
        "mission.rendezvous.arrived_m",
        0.6 * hold_m + swing_m,
        "m",
        "0.6 drone.hold_m, and how it swings",
    )
    slow_mps = 1.25 * hold_m / facts.drone.response_s
    arrived_mps = slow_mps + swing_m / facts.drone.response_s
    found.add(
        "mission.rendezvous.arrived_speed_mps", arrived_mps, "m/s", "it wanders and swings so fast"
    )
    found.add(
        "mission.rendezvous.max_speed_mps", 2.0 * slow_mps, "m/s", "twice as fast as it wanders"
    )
    found.add("mission.rendezvous.max_position_sigma_m", 0.4 * hold_m, "m", "0.4 drone.hold_m")
    most_m = range_m + 2.0 * farthest_m(separation)
    found.add("mission.rendezvous.max_range_m", most_m, "m", "the farthest viewpoint")


def _method(facts: Facts, found: _Found) -> None:
    """Derive what the method takes for the target's size and for errors that last."""
    span_m = facts.target.span_m
    found.add("method.evidence.span_m", span_m, "m", "target.length_m and width_m")
    found.add("method.evidence.height_m", facts.target.height_m, "m", "target.height_m")
    found.add("method.target_center_sigma_m", 0.12 * span_m, "m", "an eighth of the target")
    found.add("method.max_depth_spread_m", 0.8 * span_m, "m", "its own depth")
    fastest_mps = facts.target.max_speed_mps + facts.drone.hold_m / facts.drone.response_s
    found.add("method.relative_speed_mps", max(fastest_mps, 1e-3), "m/s", "target and drone")
    lens = facts.receiver.camera
    usual = MethodConfig()
    wider = 0.5 * (lens.fx + lens.fy) / USUAL_FOCAL_PX
    found.add(
        "method.min_search_px", wider * usual.min_search_px, "px", "the same angle with any camera"
    )
    found.add(
        "method.max_search_px", wider * usual.max_search_px, "px", "the same angle with any camera"
    )
    accel_mps2 = 3.0 * found["mission.max_accel_mps2"]
    found.add("method.relative_accel_mps2", accel_mps2, "m/s2", "target and both drones")
    placed = layout(
        facts,
        place_of_target(facts, _range(facts, found)[0]),
        found["mission.target.half_size_m"],
        separation_of(found),
        RendezvousConfig(
            image_margin_px=found["mission.rendezvous.image_margin_px"],
            max_range_m=found["mission.rendezvous.max_range_m"],
        ),
    )
    if not isinstance(placed.viewpoint, Viewpoint):
        return
    offset_m = predict(facts, placed).offset_sigma_m
    if facts.method.common_view:
        offset_m = _offset_by_common_view(offset_m, placed)
        _common_view(placed, found)
    found.add("method.evidence.offset_sigma_m", offset_m, "m", "all errors that last, there")
    found.add(
        "method.evidence.apart_m", max(15.0 * offset_m, 1.25 * span_m), "m", "a track's reach"
    )
    _blocks(facts, placed, found)


def _common_view(placed: Layout, found: _Found) -> None:
    """Derive how uncertain a pose may be, so that those by common views count."""
    most_m = COMMON_MOST_SHARE * placed.range_m
    found.add("method.evidence.max_pose_sigma_m", most_m, "m", "a pose by common views")


def _blocks(facts: Facts, placed: Layout, found: _Found) -> None:
    """Derive weaker blocks, and longer ones, where errors that last leave boxes too weak for the
    usual ones.

    Their rates are what was measured of blocks that weak (docs/gates.md).
    """
    usual = facts.method.evidence
    if facts.method.gate != "evidence" or placed.T_h_c2 is None:
        return
    if agreeing_share(facts, placed, usual.strength) >= AGREEING:
        return
    why = "boxes of a target this small agree weakly, by errors that last"
    for key, value in WEAK_BLOCKS.items():
        found.add(f"method.evidence.{key}", value, "s" if key.endswith("_s") else "", why)


def _waits(found: _Found) -> None:
    """Derive the waits that grow with the way to fly."""
    high_m = found["mission.receiver_take_off_height_m"]
    slow_mps = found["mission.rendezvous.max_speed_mps"]
    way_m = found["mission.rendezvous.stand_off_m"] + high_m
    range_m = math.hypot(
        found["mission.follow.behind_m"],
        found["mission.follow.height_m"] - found["mission.target.height_m"],
    )
    climb_s = found.add(
        "mission.deadlines.take_off_s", 25.0 + 2.0 * high_m, "s", "the climb at 0.5 m/s"
    )
    found.add("mission.deadlines.land_s", 35.0 + 3.0 * high_m, "s", "the way down at 0.35 m/s")
    close_s = found.add(
        "mission.deadlines.approach_s",
        20.0 + 3.0 * way_m / slow_mps,
        "s",
        "the way in, three times",
    )
    way_s = found.add("mission.deadlines.stand_off_s", 30.0 + 4.0 * way_m, "s", "the way there")
    # D1 takes its target from 1.4 times as far as it follows it from, and D2 plans once it is there
    comes_s = found.add(
        "mission.deadlines.viewpoint_s", 15.0 + 2.0 * range_m, "s", "D1 comes near its target"
    )
    look_s = Deadlines().search_s
    ready_s = comes_s + climb_s + way_s + look_s + close_s
    found.add(
        "mission.deadlines.receiver_ready_s", ready_s, "s", "all that D2 does until then, together"
    )


def _rates(facts: Facts, found: _Found) -> None:
    """Derive the gaps that are no loss where frames come slowly, or packets late and not all of
    them.
    """
    rates = [eye.rate_hz for eye in (facts.sender, facts.receiver) if eye.rate_hz is not None]
    every_s = 1.0 / min(rates) if rates else 0.0
    link = facts.link
    usual = MethodConfig()
    guard = GuardConfig()
    lost = 1.0 / (1.0 - link.loss) ** 2  # a pair takes a packet each way
    silent_s = 3.0 * every_s * lost
    waits = (
        ("method.max_gap_s", usual.max_gap_s, silent_s, "three pairs"),
        ("method.evidence.max_gap_s", usual.evidence.max_gap_s, 2.0 * silent_s, "six pairs"),
        ("method.max_bracket_s", usual.max_bracket_s, 2.5 * every_s, "two frames, and one lost"),
        (
            "method.max_extrapolation_s",
            usual.max_extrapolation_s,
            2.5 * every_s * lost + 1.5 * link.latency_s,
            "two frames and one lost, and link.latency_s",
        ),
        ("method.slope_span_s", usual.slope_span_s, 3.0 * every_s, "three frames"),
        (
            "method.max_age_s",
            usual.max_age_s,
            4.0 * link.latency_s + 2.0 * every_s,
            "link.latency_s both ways",
        ),
        (
            "mission.clock_uncertainty_s",
            0.1,
            1.5 * link.latency_s,
            "half a round trip by link.latency_s",
        ),
        ("mission.guard.frame_age_s", guard.frame_age_s, 4.0 * every_s, "four frames"),
    )
    for key, usual_s, needed_s, why in waits:
        if needed_s > usual_s:
            found.add(key, needed_s, "s", why)
