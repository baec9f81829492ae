"""The facts that a plan rests on, taken from a rig. Pure: nothing here opens a part.

A rig that has no ``[target]`` says its geometry itself; its facts are then what that geometry
implies, so that the same checks and predictions hold for both.
"""

from __future__ import annotations

import math
from dataclasses import field, replace
from typing import Any

from drivers.detectors.measured import BySize
from drivers.rig.facts import DroneFacts, HeightFacts, LinkFacts, SiteFacts, TargetFacts
from drivers.rig.parts import Mount, PartSpec, Rig, RoleRig, decode_part
from flight.config import MissionConfig
from path.camera.model import CameraModel
from path.config import MethodConfig
from path.target.monocular import TargetSize
from path.values import frozen


@frozen
class Eye:
    """One drone's camera: its lens, its place on the drone, and its frames a second (None: not
    stated).
    """

    camera: CameraModel
    mount: Mount
    rate_hz: float | None


@frozen
class Facts:
    """Everything measured or chosen that a plan follows from.

    Attributes:
        marker_side_m: of the largest print of D1's plate.
        method: for the depth camera's law and limits, and the uncertainties of mounts and pixels.
        attitude_sigma_rad: of either vehicle's roll and pitch.
        size_sigma: of a range by the target's size, relative, where D1 has no depth; 0: it has.
        height_sigma_m: of D1's height over the ground of the target, where that ranges it.
        found: share of the images in which the target is found, by its longer side in px; () where
            nobody measured it.
    """

    sender: Eye
    receiver: Eye
    marker_side_m: float
    target: TargetFacts
    drone: DroneFacts
    site: SiteFacts
    method: MethodConfig
    attitude_sigma_rad: float
    link: LinkFacts = field(default_factory=LinkFacts)
    height: HeightFacts | None = None
    size_sigma: float = 0.0
    height_sigma_m: float = 0.0
    found: BySize = ()

    def with_side(self, side_m: float) -> Facts:
        """Return these facts with another print."""
        return replace(self, marker_side_m=side_m)


def facts_of(rig: Rig, mission: MissionConfig) -> Facts:
    """Take the facts of a rig. Raises RigError for a part that cannot be decoded."""
    return Facts(
        sender=Eye(rig.sender.camera, rig.sender.mount, camera_rate_hz(rig.sender)),
        receiver=Eye(rig.receiver.camera, rig.receiver.mount, camera_rate_hz(rig.receiver)),
        marker_side_m=max(marker.side_m for marker in rig.layout.markers),
        target=rig.target or _implied_target(rig.method, mission),
        drone=rig.drone or (DroneFacts() if rig.target else _implied_drone(mission)),
        site=rig.site or _site_of_world(rig),
        method=rig.method,
        attitude_sigma_rad=math.radians(mission.attitude_sigma_deg),
        link=rig.link or LinkFacts(),
        height=rig.height,
        size_sigma=_size_sigma(rig.sender),
        height_sigma_m=0.0 if mission.target.flies else mission.height_sigma_m,
        found=() if rig.detector is None else rig.detector.rates().by_size,
    )


def _size_sigma(own: RoleRig) -> float:
    size = getattr(decode_part(own.perception)[1], "target", None)
    return size.sigma if isinstance(size, TargetSize) else 0.0


def _implied_target(method: MethodConfig, mission: MissionConfig) -> TargetFacts:
    """Return the body that a rig's own geometry implies, where it states none."""
    evidence = method.evidence
    span_m = evidence.span_m or 2.0 * mission.target.half_size_m
    height_m = evidence.height_m or 2.0 * mission.target.half_size_m
    side_m = span_m / math.sqrt(2.0)
    accel_mps2 = mission.follow.target_accel_mps2
    return TargetFacts(side_m, side_m, height_m, 0.0, accel_mps2, mission.target.flies)


def _implied_drone(mission: MissionConfig) -> DroneFacts:
    return DroneFacts(
        diameter_m=mission.separation.horizontal_m,
        response_s=mission.follow.response_s,
        max_speed_mps=mission.follow.max_speed_mps,
    )


def _site_of_world(rig: Rig) -> SiteFacts:
    """Return the wind of a simulated rig's world; of one that flies outdoors what is usual."""
    wind: dict[str, Any] = dict(rig.world.get("wind", {}))
    usual = SiteFacts()
    return SiteFacts(
        float(wind.get("speed_mps", usual.wind_mps)), float(wind.get("gust_mps", usual.gust_mps))
    )


def camera_rate_hz(own: RoleRig) -> float | None:
    """Return a role's camera rate in frames a second; None when its part does not say. Raises
    RigError.
    """
    config = decode_part(own.perception)[1]
    inner = getattr(config, "camera", None)
    if isinstance(inner, PartSpec):
        config = decode_part(inner)[1]
    rate = getattr(config, "rate_hz", None) or getattr(config, "fps", None)
    return None if rate is None else float(rate)
