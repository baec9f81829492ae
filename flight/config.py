"""The heights, distances, limits and deadlines of a mission (the ``[mission]`` table of a rig)."""

from __future__ import annotations

from dataclasses import field
from typing import Annotated, Literal

from drivers.interfaces import Capability
from drivers.operator.interfaces import PlaceTold
from drivers.rig.obstacle import Obstacle
from flight.fence import Fence
from flight.guard.rules import GuardRules
from flight.guidance import Answer, Vec3
from path.bounds import Bounds
from path.values import frozen


def off_from(home_m: tuple[float, ...] | None, position_n_m: Vec3) -> tuple[float, float]:
    """Returns how far off, north and east, a drone that stands at home takes itself to be; 0 where
    no home is known.
    """
    return (position_n_m[0] - home_m[0], position_n_m[1] - home_m[1]) if home_m else (0.0, 0.0)


@frozen
class TargetDesignation:
    """The object that the sender is to track: where the operator pointed, when, and what it did, in
    the local frame.
    """

    north_m: Annotated[float, Bounds(-1000.0, 1000.0)] = 4.0
    east_m: Annotated[float, Bounds(-1000.0, 1000.0)] = 0.0
    # of the object's middle above the ground
    height_m: Annotated[float, Bounds(-10.0, 100.0)] = 0.10
    # around its middle, as much as must be in view
    half_size_m: Annotated[float, Bounds(0.02, 3.0)] = 0.25
    flies: bool = False  # it moves up and down too; else it stays as high as it was
    # standard deviation of the place on each axis: of the pointing, and of the drone's own position
    error_m: Annotated[float, Bounds(0.01, 20.0)] = 0.3
    # the same as a bound that is hardly ever exceeded, three standard deviations: instead of
    # error_m
    radius_m: Annotated[float | None, Bounds(0.03, 60.0)] = None
    # where the drone stands before take-off, north and east, as the crew measured it like the
    # place: then what its own position is off there is taken out of the place; unstated, its
    # position is believed
    home_m: Annotated[tuple[float, float] | None, Bounds(-1000.0, 1000.0)] = None
    # how far off the drone's own position may be in flight, besides that: one that walks
    own_m: Annotated[float, Bounds(0.0, 50.0)] = 0.0
    # of the designation, when the drone's program starts
    age_s: Annotated[float, Bounds(0.0, 3600.0)] = 0.0
    # what it drove when it was pointed at, where that is known
    velocity_mps: Annotated[tuple[float, ...], Bounds(-15.0, 15.0)] = ()
    # for so long it is known to stand, or to go on driving so
    holds_s: Annotated[float, Bounds(0.0, 36000.0)] = 0.0
    # the most that it can drive; what a drone follows is no faster than follow.max_speed_mps
    fastest_mps: Annotated[float, Bounds(0.01, 15.0)] = 1.2

    def __post_init__(self) -> None:
        if len(self.velocity_mps) not in (0, 2):
            raise ValueError("velocity_mps must be two numbers, north and east, or empty")

    def told(self, begun_ns: int) -> PlaceTold:
        """Return it as the statement that it is, made ``age_s`` before the drone's program
        began.
        """
        return PlaceTold(
            stamp_ns=begun_ns - round(self.age_s * 1e9),
            place_n_m=(self.north_m, self.east_m, -self.height_m),
            error_m=self.error_m if self.radius_m is None else self.radius_m / 3.0,
            height_told=self.flies,
            velocity_n_mps=(self.velocity_mps[0], self.velocity_mps[1])
            if self.velocity_mps
            else None,
            holds_s=self.holds_s,
        )


@frozen
class FollowConfig:
    """The place of a drone relative to the target it follows, in the heading it came with."""

    behind_m: Annotated[float, Bounds(0.0, 30.0)] = 1.45  # horizontal distance
    # above the ground, of a target that is as high as it was designated; else as much above the
    # target as there
    height_m: Annotated[float, Bounds(0.3, 100.0)] = 1.50
    gain_per_s: Annotated[float, Bounds(0.05, 10.0, "1/s")] = 1.0
    max_speed_mps: Annotated[float, Bounds(0.1, 15.0)] = 1.2
    # until the vehicle has answered to 63 % of a new velocity (docs/conformance.md)
    response_s: Annotated[float, Bounds(0.1, 5.0)] = 1.0
    # how hard the target speeds up, brakes and turns
    target_accel_mps2: Annotated[float, Bounds(0.0, 10.0)] = 0.6
    # for so long after the detector found it a target that stands out from what is behind it is
    # followed by its depth
    carry_s: Annotated[float, Bounds(0.0, 60.0)] = 6.0
    # after so long at its first place without a target the sender goes round the designated place,
    # and looks from other sides, until deadlines.acquire_s; 0: never
    look_round_s: Annotated[float, Bounds(0.0, 3600.0)] = 3.0

    def answer(self, accel_mps2: float) -> Answer:
        """Returns the way to fly there with setpoints of that acceleration."""
        return Answer(self.gain_per_s, self.max_speed_mps, self.response_s, accel_mps2)


@frozen
class SeparationConfig:
    """The volume around D1 that D2's camera stays out of, and the air below the upper drone."""

    horizontal_m: Annotated[float, Bounds(0.1, 20.0)] = 0.60
    vertical_m: Annotated[float, Bounds(0.1, 20.0)] = 0.45
    # between the two bodies, at the planned viewpoint
    viewpoint_m: Annotated[float, Bounds(0.2, 20.0)] = 1.05
    # between the receiver's camera and the marker there, where there is such a viewpoint: that is
    # what is measured, and an approach that measures no more than minimum_m + 0.15 m goes around
    marker_m: Annotated[float, Bounds(0.2, 20.0)] = 1.05
    # between the two bodies: the guard ends the mission below it
    minimum_m: Annotated[float, Bounds(0.2, 20.0)] = 0.70
    # beside the upper drone's jet, just below it and more for each metre below: nearer it pushes the
    # lower one harder than that holds (flight.wash)
    wash_m: Annotated[float, Bounds(0.0, 20.0)] = 0.5
    wash_per_m: Annotated[float, Bounds(0.0, 5.0, "m a metre")] = 0.073
    # how far the jet leans, for each metre below: times the slope that wind tilts a drone by
    wash_lean: Annotated[float, Bounds(0.0, 50.0, "times")] = 5.0


@frozen
class RendezvousConfig:
    """Stand-off, search and approach of the receiver."""

    # how far apart the drones' reported positions may be wrong, across ...
    positions_within_m: Annotated[float, Bounds(0.0, 20.0)] = 1.1
    heights_within_m: Annotated[float, Bounds(0.0, 20.0)] = 0.9  # ... and in height
    # where the receiver stands before take-off, north and east, measured like
    # mission.target.home_m: what both drones' positions are off there is taken out of them; empty:
    # not known
    home_m: Annotated[tuple[float, ...], Bounds(-1000.0, 1000.0)] = ()
    # from the marker, along the camera's axis, of a drone that sees what is ahead of it
    stand_off_m: Annotated[float, Bounds(0.3, 30.0)] = 1.75
    # at the stand-off, besides the smallest separation, if positions are that wrong
    clearance_m: Annotated[float, Bounds(0.0, 10.0)] = 0.3
    stand_off_tolerance_m: Annotated[float, Bounds(0.02, 5.0)] = 0.25
    # farthest outward from the stand-off; farther where positions may be that wrong
    search_slide_m: Annotated[float, Bounds(0.0, 20.0)] = 0.8
    search_turn_deg: Annotated[float, Bounds(0.0, 180.0)] = 50.0  # farthest to either side
    # new searches after approaches in which something was out of its bounds
    go_arounds: Annotated[int, Bounds(0, 20, "times")] = 2
    gain_per_s: Annotated[float, Bounds(0.05, 10.0, "1/s")] = 0.9
    max_speed_mps: Annotated[float, Bounds(0.05, 10.0)] = 0.5
    arrived_m: Annotated[float, Bounds(0.01, 2.0)] = 0.12
    arrived_speed_mps: Annotated[float, Bounds(0.01, 5.0)] = 0.25
    # of the marker pose, to close in on it
    max_position_sigma_m: Annotated[float, Bounds(0.001, 1.0)] = 0.08
    min_marker_px: Annotated[float, Bounds(20.0, 1000.0)] = 20.0
    max_incidence_deg: Annotated[float, Bounds(5.0, 80.0)] = 60.0
    image_margin_px: Annotated[float, Bounds(0.0, 2000.0)] = 80.0
    # target to D2, its depth camera's useful limit
    max_range_m: Annotated[float, Bounds(0.5, 50.0)] = 4.5

    def __post_init__(self) -> None:
        if len(self.home_m) not in (0, 2):
            raise ValueError("home_m must be two numbers, north and east, or empty")


@frozen
class GuardConfig:
    """Limits that beat every script (S8-S10)."""

    fence_radius_m: Annotated[float, Bounds(2.0, 1000.0)] = 25.0
    fence_height_m: Annotated[float, Bounds(1.0, 120.0)] = 6.0
    # (north, east) of the corners of a site with walls, in order; empty: the circle alone
    corners_m: Annotated[tuple[tuple[float, float], ...], Bounds(-1000.0, 1000.0)] = ()
    # what stands in the way, as far as the crew knows
    obstacles: tuple[Obstacle, ...] = ()
    # more may stand there: drones keep off what their depth cameras see
    unmeasured: bool = False
    # from walls and obstacles, besides a body's radius: how far a drone wanders, and what its
    # positions are worth
    clear_m: Annotated[float, Bounds(0.0, 50.0)] = 0.0
    min_battery: Annotated[float, Bounds(0.05, 0.9, "of 1")] = 0.20
    telemetry_age_s: Annotated[float, Bounds(0.05, 5.0)] = 0.5
    heartbeat_age_s: Annotated[float, Bounds(0.2, 10.0)] = 2.5
    frame_age_s: Annotated[float, Bounds(0.05, 5.0)] = 0.8
    peer_silence_s: Annotated[float, Bounds(0.2, 60.0)] = 3.0
    # while both verify: a drone whose program died is about to land, a metre away
    near_silence_s: Annotated[float, Bounds(0.1, 10.0)] = 0.8

    def __post_init__(self) -> None:
        if len(self.corners_m) in (1, 2):
            raise ValueError("corners_m must be three corners or more, or empty")

    def fence(self, body_m: float = 0.0) -> Fence:
        """Return the space in which the drones may be."""
        return Fence(
            self.fence_radius_m, self.fence_height_m, self.corners_m, body_m, self.obstacles
        )


@frozen
class Deadlines:
    """Every wait of a mission is bounded; what a deadline ends in is the outcome's name."""

    armable_s: Annotated[float, Bounds(0.1, 3600.0)] = 45.0
    guard_s: Annotated[float, Bounds(0.1, 3600.0)] = 15.0
    peer_s: Annotated[float, Bounds(0.1, 3600.0)] = 60.0
    take_off_s: Annotated[float, Bounds(0.1, 3600.0)] = 30.0
    # what moves among its like: D1 looks from other sides, asks, waits for an answer, and until it
    # is sure
    acquire_s: Annotated[float, Bounds(0.1, 3600.0)] = 60.0
    receiver_ready_s: Annotated[float, Bounds(0.1, 3600.0)] = 120.0
    viewpoint_s: Annotated[float, Bounds(0.1, 3600.0)] = 15.0
    stand_off_s: Annotated[float, Bounds(0.1, 3600.0)] = 40.0
    search_s: Annotated[float, Bounds(0.1, 3600.0)] = 45.0
    approach_s: Annotated[float, Bounds(0.1, 3600.0)] = 30.0
    verify_s: Annotated[float, Bounds(0.1, 3600.0)] = 60.0
    target_coast_s: Annotated[float, Bounds(0.0, 60.0)] = 2.0
    target_regain_s: Annotated[float, Bounds(0.0, 60.0)] = (
        4.0  # after it, to be seen again; nothing is handed over before
    )
    marker_coast_s: Annotated[float, Bounds(0.0, 60.0)] = 1.0
    marker_regain_s: Annotated[float, Bounds(0.0, 60.0)] = 4.0
    # in verification, after both: D2 holds off at its stand-off, by reported positions that the
    # marker has set right, and looks for it from there
    marker_away_s: Annotated[float, Bounds(0.0, 60.0)] = 12.0
    depart_s: Annotated[float, Bounds(0.1, 3600.0)] = 20.0
    land_s: Annotated[float, Bounds(0.1, 3600.0)] = 40.0


@frozen
class MissionConfig:
    """One handoff mission, both roles."""

    # of the vehicle and the perception, besides what the course itself needs
    needs: tuple[Capability, ...] = ()
    handoff_id: Annotated[int, Bounds(1, 65535, "(an id)")] = 1
    target_id: Annotated[int, Bounds(1, 65535, "(an id)")] = 1
    # of the sender's approach to the target
    heading_deg: Annotated[float, Bounds(-360.0, 360.0)] = 0.0
    take_off_height_m: Annotated[float, Bounds(0.3, 100.0)] = 1.5
    receiver_take_off_height_m: Annotated[float, Bounds(0.3, 100.0)] = 2.2
    control_hz: Annotated[float, Bounds(5.0, 200.0)] = 20.0
    # a camera that is fixed to the body tilts with every acceleration: 0.8 is 5 degrees
    max_accel_mps2: Annotated[float, Bounds(0.05, 10.0)] = 0.8
    # looks at the target while only the own following depends on them
    follow_hz: Annotated[float, Bounds(1.0, 200.0)] = 25.0
    # of the sender: the receiver flies by its velocity
    status_hz: Annotated[float, Bounds(0.5, 50.0)] = 10.0
    receiver_status_hz: Annotated[float, Bounds(0.5, 50.0)] = 4.0
    # an offset between the drones' clocks that is known no better than this is not used: half a
    # round trip bounds it
    clock_uncertainty_s: Annotated[float, Bounds(0.001, 2.0)] = 0.1
    # once the clocks are aligned; with every Status before
    ping_hz: Annotated[float, Bounds(0.1, 50.0)] = 1.0
    # "all": every frame too, in a file beside the log
    record: Literal["none", "keyframes", "all"] = "keyframes"
    image_hz: Annotated[float, Bounds(0.0, 60.0)] = 1.0  # camera images in the log: its key frames
    # how long D2 follows before it lands
    follow_after_s: Annotated[float, Bounds(0.0, 36000.0)] = 6.0
    depart_m: Annotated[float, Bounds(0.5, 50.0)] = 2.5
    # looks at the whole image for the marker
    search_hz: Annotated[float, Bounds(0.5, 100.0)] = 10.0
    # of either vehicle's roll and pitch, for the gravity prior
    attitude_sigma_deg: Annotated[float, Bounds(0.01, 20.0)] = 0.6
    # of the sender's height above the ground that the target stands on: it betters a range that is
    # only estimated, by where the target's ray meets its height; 0: not stated
    height_sigma_m: Annotated[float, Bounds(0.0, 10.0)] = 0.0
    # the ground at the target is as high as at the homes: what the target's measured height is off,
    # the drone's own is
    level_ground: bool = False
    # how much more either attitude errs at one time than at another
    attitude_wander_deg: Annotated[float, Bounds(0.0, 20.0)] = 0.25
    target: TargetDesignation = field(default_factory=TargetDesignation)
    follow: FollowConfig = field(default_factory=FollowConfig)
    separation: SeparationConfig = field(default_factory=SeparationConfig)
    rendezvous: RendezvousConfig = field(default_factory=RendezvousConfig)
    guard: GuardConfig = field(default_factory=GuardConfig)
    guard_process: GuardRules = field(default_factory=GuardRules)
    deadlines: Deadlines = field(default_factory=Deadlines)

    @property
    def fence(self) -> Fence:
        """Return the space in which the drones may be, for the middle of a body that is not quite
        where it seems.
        """
        return self.guard.fence(0.5 * self.separation.horizontal_m + self.guard.clear_m)
