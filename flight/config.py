"""What a mission flies: heights, distances, limits and deadlines (the ``[mission]`` table of a rig)."""

from __future__ import annotations

from dataclasses import dataclass, field

from drivers.interfaces import Capability
from flight.guard_rules import GuardRules


@dataclass(frozen=True, slots=True)
class TargetDesignation:
    """Which object the sender is to track: the place where the operator pointed, in the mission's local frame."""

    north_m: float = 4.0
    east_m: float = 0.0
    height_m: float = 0.10  # of the object's middle above the ground
    radius_m: float = 0.9  # how far from the place an object may be and still be the one meant


@dataclass(frozen=True, slots=True)
class FollowConfig:
    """Where a drone stays relative to the target it follows, in the heading it came with."""

    behind_m: float = 1.45  # horizontal distance
    height_m: float = 1.50  # above the ground
    gain_per_s: float = 1.0
    max_speed_mps: float = 1.2
    target_accel_mps2: float = 0.6  # how hard the target speeds up, brakes and turns


@dataclass(frozen=True, slots=True)
class SeparationConfig:
    """The volume around D1 that D2's camera stays out of, and the downwash cone below the upper drone."""

    horizontal_m: float = 0.60
    vertical_m: float = 0.45
    viewpoint_m: float = 1.05  # between the two bodies, at the planned viewpoint
    minimum_m: float = 0.70  # between the two bodies: the guard ends the mission below it
    downwash_half_angle_deg: float = 30.0


@dataclass(frozen=True, slots=True)
class RendezvousConfig:
    """Stand-off, search and approach of the receiver."""

    positions_within_m: float = 1.1  # how far apart the drones' reported positions may be wrong, across ...
    heights_within_m: float = 0.9  # ... and in height
    stand_off_m: float = 1.75  # from the marker, along the camera's axis, of a drone that sees what is ahead of it
    clearance_m: float = 0.3  # at the stand-off, besides the smallest separation, if positions are that wrong
    stand_off_tolerance_m: float = 0.25
    search_slide_m: float = 0.8  # farthest outward from the stand-off; farther where positions may be that wrong
    search_turn_deg: float = 50.0  # farthest to either side
    go_arounds: int = 2  # new searches after approaches in which something was out of its bounds
    gain_per_s: float = 0.9
    max_speed_mps: float = 0.5
    arrived_m: float = 0.12
    arrived_speed_mps: float = 0.25
    max_position_sigma_m: float = 0.08  # of the marker pose, to close in on it
    min_marker_px: float = 20.0
    max_incidence_deg: float = 60.0
    image_margin_px: float = 80.0
    max_range_m: float = 4.5  # target to D2, its depth camera's useful limit


@dataclass(frozen=True, slots=True)
class GuardConfig:
    """Limits that beat every script (S8-S10)."""

    fence_radius_m: float = 25.0
    fence_height_m: float = 6.0
    min_battery: float = 0.20
    telemetry_age_s: float = 0.5
    heartbeat_age_s: float = 2.5
    frame_age_s: float = 0.8
    peer_silence_s: float = 3.0
    near_silence_s: float = 0.8  # while both verify: a drone whose program died is about to land, a metre away


@dataclass(frozen=True, slots=True)
class Deadlines:
    """Every wait of a mission is bounded; what a deadline ends in is the outcome's name."""

    armable_s: float = 45.0
    guard_s: float = 15.0
    peer_s: float = 60.0
    take_off_s: float = 30.0
    acquire_s: float = 10.0  # what was pointed at does not wait for ever
    receiver_ready_s: float = 120.0
    viewpoint_s: float = 15.0
    stand_off_s: float = 40.0
    search_s: float = 45.0
    approach_s: float = 30.0
    verify_s: float = 60.0
    target_coast_s: float = 2.0
    target_regain_s: float = 4.0  # after it, of a sender that nobody verifies with yet
    marker_coast_s: float = 1.0
    marker_regain_s: float = 4.0
    depart_s: float = 20.0
    land_s: float = 40.0


@dataclass(frozen=True, slots=True)
class MissionConfig:
    """One handoff mission, both roles."""

    needs: tuple[Capability, ...] = ()  # of the vehicle and the sight, besides what the course itself needs
    handoff_id: int = 1
    target_id: int = 1
    heading_deg: float = 0.0  # of the sender's approach to the target
    take_off_height_m: float = 1.5
    receiver_take_off_height_m: float = 2.2
    control_hz: float = 20.0
    max_accel_mps2: float = 0.8  # a camera that is fixed to the body tilts with every acceleration: 0.8 is 5 degrees
    follow_hz: float = 25.0  # looks at the target while only the own following depends on them
    status_hz: float = 10.0  # of the sender: the receiver flies by its velocity
    receiver_status_hz: float = 4.0
    ping_hz: float = 1.0  # once the clocks are aligned; with every Status before
    image_hz: float = 1.0  # camera images in the log
    follow_after_s: float = 6.0  # how long D2 follows before it lands
    depart_m: float = 2.5
    search_hz: float = 10.0  # looks at the whole image for the marker
    attitude_sigma_deg: float = 0.6  # of either vehicle's roll and pitch, for the gravity prior
    attitude_wander_deg: float = 0.25  # how much more either attitude errs at one time than at another
    target: TargetDesignation = field(default_factory=TargetDesignation)
    follow: FollowConfig = field(default_factory=FollowConfig)
    separation: SeparationConfig = field(default_factory=SeparationConfig)
    rendezvous: RendezvousConfig = field(default_factory=RendezvousConfig)
    guard: GuardConfig = field(default_factory=GuardConfig)
    guard_process: GuardRules = field(default_factory=GuardRules)
    deadlines: Deadlines = field(default_factory=Deadlines)
