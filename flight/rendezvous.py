"""How D2 gets to D1: stand-off by reported positions, search for the marker, approach by the marker alone."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from drivers.interfaces import VehicleState, VelocitySetpoint
from drivers.rig import Mount
from flight.config import MissionConfig
from flight.guidance import Vec3, add, bearing, close_in, from_heading, norm, scale, subtract
from flight.marker_view import MarkerView, levelled
from flight.viewpoint import NoViewpoint, Scene, Viewpoint, plan_viewpoint
from path.camera import CameraModel
from path.geometry import Matrix
from path.marker.layout import MarkerLayout
from path.messages import Status, Target
from path.rotation import wrapped, yaw_of

_TRANSIT_MPS = 1.0
_UNSURE_SHARE = 0.3  # of the speed, while the marker's pose is uncertain
_BACK_OFF_MPS = 0.25
_SETTLE_S = 1.5  # at the stand-off, before it starts to slide
_LEAN_SHARE = 0.05  # of each frame in the smoothed lean


class Rendezvous:
    """Guidance of the receiver until the target is its own. The guidance methods are ``flight.pilot.Guidance``.

    Args:
        peer: the sender's newest Status; asked only once there is one.
        now_ns: role clock.
    """

    def __init__(
        self,
        config: MissionConfig,
        camera: CameraModel,
        mount: Mount,
        marker: MarkerView,
        peer: Callable[[], Status],
        now_ns: Callable[[], int],
    ) -> None:
        self._config = config
        self._camera = camera
        self._mount = mount
        self._marker = marker
        self._peer = peer
        self._now_ns = now_ns
        self._viewpoint: Viewpoint | None = None
        self._search_began_ns = 0
        self._lean_n: Vec3 = (0.0, 0.0, 1.0)  # own z axis in NED, smoothed: the wind leans a hovering drone

    @property
    def viewpoint(self) -> Viewpoint:
        assert self._viewpoint is not None, "there is no way to a viewpoint before one is planned"
        return self._viewpoint

    def note_lean(self, R_n_b: Matrix) -> None:
        """Own attitude in a frame."""
        north, east, down = R_n_b[:, 2].tolist()
        self._lean_n = add(scale(self._lean_n, 1.0 - _LEAN_SHARE), scale((north, east, down), _LEAN_SHARE))

    def plan(self, target: Target, layout: MarkerLayout) -> Viewpoint | NoViewpoint:
        """Plan the viewpoint for the geometry the sender reports now; a found one is flown to from now on."""
        R_h_v = levelled(target.gravity_v, self._mount.T_b_v.R)
        scene = Scene(
            target_h_m=R_h_v @ np.array(target.point_v_m),
            marker_normal_h=R_h_v[:, 2],
            marker_side_m=max(marker.side_m for marker in layout.markers),
            body_h_m=R_h_v @ self._mount.T_b_v.inverse().t,
        )
        tilt_h = np.array(from_heading(self._lean_n, -self._peer().yaw_rad))
        tilt_h /= np.linalg.norm(tilt_h)
        config = self._config
        plan = plan_viewpoint(scene, self._camera, self._mount.T_b_c, config.rendezvous, config.separation, tilt_h)
        if isinstance(plan, Viewpoint):
            self._viewpoint = plan
        return plan

    # --- stand-off and search: by the positions both drones report -------------------------------------------------

    def to_stand_off(self, state: VehicleState) -> VelocitySetpoint:
        """To where the marker faces D2, in the middle of the image, if both positions are right.

        That is not on the viewpoint's side: with positions off by a metre the marker would be seen edge-on there.
        """
        place, yaw = self._stand_off()
        return self._by_position(place, state, yaw)

    def at_stand_off(self, state: VehicleState) -> bool:
        off_m = norm(subtract(self._stand_off()[0], state.position_n_m))
        return off_m < self._config.rendezvous.stand_off_tolerance_m

    def begin_search(self) -> None:
        self._search_began_ns = self._now_ns()

    def search(self, state: VehicleState) -> VelocitySetpoint:
        """Look to and fro, wider as time goes, and slide outward and back, until the marker shows.

        Never inward: the positions that the stand-off rests on may be wrong by more than is left. A drone that is
        nearly above the other sees it only from farther out.
        """
        place, yaw = self._stand_off()
        rendezvous = self._config.rendezvous
        searched_s = max(0.0, (self._now_ns() - self._search_began_ns) * 1e-9 - _SETTLE_S)
        turn = math.radians(rendezvous.search_turn_deg) * min(1.0, 0.3 * searched_s) * math.sin(1.1 * searched_s)
        back_m = 0.5 * rendezvous.search_slide_m * (1.0 - math.cos(0.3 * searched_s))
        return self._by_position(add(place, from_heading((-back_m, 0.0, 0.0), yaw)), state, yaw + turn)

    def _stand_off(self) -> tuple[Vec3, float]:
        peer, stand_off_m = self._peer(), self._config.rendezvous.stand_off_m
        steepness = math.asin(float(self._mount.T_b_c.R[2, 2]))  # how far below the horizon the camera looks
        level_m, height_m = stand_off_m * math.cos(steepness), stand_off_m * math.sin(steepness)
        normal_b = self._mount.T_b_v.R[:, 2]  # of the plate, in D1's body
        facing = math.hypot(float(normal_b[0]), float(normal_b[1]))
        ahead, right = (float(normal_b[0]) / facing, float(normal_b[1]) / facing) if facing > 0.1 else (-1.0, 0.0)
        offset = from_heading((level_m * ahead, level_m * right, -height_m), peer.yaw_rad)
        return add(peer.position_n_m, offset), bearing(scale(offset, -1.0))

    def _by_position(self, place_n_m: Vec3, state: VehicleState, yaw_rad: float) -> VelocitySetpoint:
        error, gain = subtract(place_n_m, state.position_n_m), self._config.rendezvous.gain_per_s
        return VelocitySetpoint(close_in(error, self._peer().velocity_n_mps, gain, _TRANSIT_MPS), yaw_rad)

    # --- approach: by the marker alone -----------------------------------------------------------------------------

    def to_viewpoint(self, state: VehicleState) -> VelocitySetpoint:
        """Close in on the planned place; when the marker was not seen for too long, back off to see it again."""
        relative, peer = self._marker.predict(self._now_ns()), self._peer()
        if relative is None:
            heading = yaw_of(state.q_n_b)
            away = from_heading((-_BACK_OFF_MPS, 0.0, 0.0), heading)
            return VelocitySetpoint(add(peer.velocity_n_mps, away), heading)
        rendezvous = self._config.rendezvous
        sure = relative.sigma_m <= rendezvous.max_position_sigma_m
        speed = rendezvous.max_speed_mps * (1.0 if sure else _UNSURE_SHARE)
        error = self._off_viewpoint(relative.marker_n_m)
        velocity = close_in(error, peer.velocity_n_mps, rendezvous.gain_per_s, speed)
        return VelocitySetpoint(velocity, self._yaw_between(relative.marker_n_m))

    def at_viewpoint(self) -> bool:
        """There, and slow."""
        relative, rendezvous = self._marker.predict(self._now_ns()), self._config.rendezvous
        return (
            relative is not None
            and norm(self._off_viewpoint(relative.marker_n_m)) < rendezvous.arrived_m
            and norm(relative.velocity_n_mps) < rendezvous.arrived_speed_mps
        )

    def _off_viewpoint(self, marker_n_m: Vec3) -> Vec3:
        """What is missing to the viewpoint, given the way from the camera to the marker."""
        return add(from_heading(self.viewpoint.camera_h_m, self._peer().yaw_rad), marker_n_m)

    def _yaw_between(self, marker_n_m: Vec3) -> float:
        """So that marker and target share the image."""
        to_marker = bearing(marker_n_m)
        if self._marker.target_n_m is None:
            return self._peer().yaw_rad + self.viewpoint.yaw_h_rad
        return to_marker + 0.5 * wrapped(bearing(self._marker.target_n_m) - to_marker)
