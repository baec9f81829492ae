"""Where both drones and the target are at the hand-over, and what their cameras then see. Pure.

Frame ``h``: D1's heading (forward, right, down), origin at D1's body, level. Lengths in m, angles
in rad.

D1's camera is fixed at an angle below the horizon. At a range R along its axis it is R sin(angle)
above the target and R cos(angle) behind it. D2 is where ``flight.rendezvous.viewpoint`` puts it.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from drivers.rig.facts import TargetFacts
from flight.config import MissionConfig, RendezvousConfig, SeparationConfig
from flight.plan.facts import Facts
from flight.rendezvous.viewpoint import NoViewpoint, Viewpoint, ViewpointScene, plan_viewpoint
from path.geometry.transforms import Pose
from path.values import frozen

Floats = NDArray[np.float64]

# Of what flies on rotors: the share of its length, width and height that detectors draw a box
# around. They see the body, not thin arms and turning rotors: 62 x 54 px of 0.31 m from 1.9 m.
BOXED_OF_ROTORS = 0.5


@frozen
class Apparent:
    """A target as it fills an image: its width and height in m at its own depth, and in px."""

    width_m: float
    height_m: float
    width_px: float
    height_px: float

    @property
    def short_px(self) -> float:
        """Return the shorter side of its box."""
        return min(self.width_px, self.height_px)


@frozen
class Layout:
    """The geometry of a hand-over.

    Attributes:
        range_m: along D1's optical axis, from its camera to the target's middle.
        target_h: the target's middle, shape (3,).
        viewpoint: D2's camera, from the marker in ``h``; or why there is no place for it.
        T_h_c2: D2's camera; None without a viewpoint.
    """

    range_m: float
    target_h: Floats
    viewpoint: Viewpoint | NoViewpoint
    T_h_c2: Pose | None

    @property
    def receiver_range_m(self) -> float:
        """Return the distance from D2's camera to the target; NaN without a viewpoint."""
        if self.T_h_c2 is None:
            return math.nan
        return float(np.linalg.norm(self.target_h - self.T_h_c2.t))


def depression_rad(facts: Facts) -> float:
    """Return how far below the horizon D1's camera looks."""
    return math.asin(max(-1.0, min(1.0, float(facts.sender.mount.T_b_c.R[2, 2]))))


def apparent(facts: Facts, range_m: float) -> Apparent:
    """Return how the target fills D1's image at a range along its axis.

    An upright cylinder of diameter s and height H, seen from an angle a above the horizon, is s
    wide and H cos(a) + s sin(a) high.
    """
    target = facts.target
    camera = facts.sender.camera
    angle = depression_rad(facts)
    share = boxed_share(target)
    width_m = share * target.span_m
    height_m = share * (target.height_m * math.cos(angle) + target.span_m * math.sin(angle))
    return Apparent(
        width_m,
        height_m,
        camera.fx * width_m / range_m,
        camera.fy * height_m / range_m,
    )


def boxed_share(target: TargetFacts) -> float:
    """Return the share of a target's sides that its box has."""
    return BOXED_OF_ROTORS if target.flies else 1.0


def place_of_target(facts: Facts, range_m: float) -> Floats:
    """Return the target's middle in ``h`` when it is that far along D1's optical axis."""
    T_b_c = facts.sender.mount.T_b_c
    return T_b_c.t + range_m * T_b_c.R[:, 2]


def followed_at(mission: MissionConfig) -> Floats:
    """Return the target's middle in ``h`` where a mission's own settings have D1 follow it, shape
    (3,).
    """
    return np.array(
        [mission.follow.behind_m, 0.0, mission.follow.height_m - mission.target.height_m]
    )


def range_to(facts: Facts, target_h: Floats) -> float:
    """Return the distance from D1's camera to a place in ``h``."""
    return float(np.linalg.norm(target_h - facts.sender.mount.T_b_c.t))


def layout(
    facts: Facts,
    target_h: Floats,
    radius_m: float,
    separation: SeparationConfig,
    rendezvous: RendezvousConfig,
    *,
    tilt_h: Floats | None = None,
) -> Layout:
    """Plan D2's viewpoint.

    Args:
        target_h: the target's middle, shape (3,).
        radius_m: about that middle, what must be in view.
        tilt_h: D2's body z axis in ``h`` as it hovers in wind, shape (3,); None: level.
    """
    range_m = range_to(facts, target_h)
    carried = facts.sender.mount.T_b_v
    scene = ViewpointScene(
        target_h_m=target_h - carried.t,
        marker_normal_h=carried.R[:, 2],
        marker_side_m=facts.marker_side_m,
        body_h_m=-carried.t,
        body_radius_m=0.5 * facts.drone.diameter_m,
        target_radius_m=radius_m,
    )
    eye = facts.receiver
    found = plan_viewpoint(scene, eye.camera, eye.mount.T_b_c, rendezvous, separation, tilt_h)
    if isinstance(found, NoViewpoint):
        return Layout(range_m, target_h, found, None)
    return Layout(range_m, target_h, found, _pose_of(facts, found))


def flown_layout(facts: Facts, mission: MissionConfig) -> Layout:
    """Plan D2's viewpoint where a mission's own settings have D1 follow the target."""
    return layout(
        facts,
        followed_at(mission),
        mission.target.half_size_m,
        mission.separation,
        mission.rendezvous,
    )


def target_radius_m(facts: Facts) -> float:
    """Return the radius about the target's middle that must be in view, between half its width and
    half its height.
    """
    seen = apparent(facts, 1.0)
    return 0.25 * (seen.width_m + seen.height_m) / boxed_share(facts.target)


def _pose_of(facts: Facts, found: Viewpoint) -> Pose:
    c = math.cos(found.yaw_h_rad)
    s = math.sin(found.yaw_h_rad)
    R_h_b = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    place = facts.sender.mount.T_b_v.t + np.array(found.camera_h_m)
    return Pose(R_h_b @ facts.receiver.mount.T_b_c.R, place)


def tilts(angle_rad: float) -> list[Floats]:
    """Return a drone's body z axis in wind of eight directions that tilts it so much."""
    turns = [math.radians(45.0 * k) for k in range(8)]
    level = math.sin(angle_rad)
    upright = math.cos(angle_rad)
    return [np.array([level * math.cos(turn), level * math.sin(turn), upright]) for turn in turns]
