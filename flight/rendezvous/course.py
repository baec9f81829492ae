"""D2's way to D1: stand-off by reported positions, search for the marker, approach by the marker
alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from drivers.interfaces import VehicleState, VelocitySetpoint
from drivers.rig.parts import Mount, RoleRig
from flight.common_view import KEYFRAME_S
from flight.config import MissionConfig
from flight.guidance import (
    Answer,
    Vec3,
    add,
    approach,
    bearing,
    close_in,
    from_heading,
    norm,
    scale,
    subtract,
    within_fence,
)
from flight.rendezvous.common_ground import CommonGround
from flight.rendezvous.marker_view import MarkerView, levelled
from flight.rendezvous.viewpoint import (
    Floats,
    NoViewpoint,
    Viewpoint,
    ViewpointScene,
    beside_wash_m,
    farthest_m,
    plan_viewpoint,
)
from flight.tilt import Tilt
from path.camera.model import CameraModel
from path.geometry.rotation import wrapped, yaw_of
from path.geometry.transforms import Pose
from path.marker.layout import MarkerLayout
from path.messages import Status, Target

_TRANSIT_MPS = 1.0
# rad/s of the search's three swings: no two are in step for long
_TURN = 1.1
_SLIDE = 0.3
_CLIMB = 0.19
_TOO_NEAR = 3.0 / 14.0  # of the smallest separation, above it
_RUSHING_MPS = 0.4  # above the speed of an approach
_UNCERTAIN = 2.0  # times the largest uncertainty to close in with
_UNSURE_SHARE = 0.3  # of the speed, while the marker's pose is uncertain
_BACK_OFF_MPS = 0.25
_CLIMB_MPS = 0.4
_SETTLE_S = 1.5  # where it came in to, before it starts to slide
_COME_IN_MPS = 0.3
_SHOWN_S = 1.5 * KEYFRAME_S  # ago, D1 saw what its keyframe shows: while it is sent, and used
_FINDABLE_PX = 14.0  # of a marker's side: found in nearly every image, at a slant too


def stand_off_m(config: MissionConfig) -> float:
    """Return the distance that reported positions may lead to.

    It is clear of the other drone even if they are wrong by all that they may be.
    """
    rendezvous = config.rendezvous
    wrong_m = math.hypot(rendezvous.positions_within_m, rendezvous.heights_within_m)
    return max(
        rendezvous.stand_off_m, config.separation.minimum_m + rendezvous.clearance_m + wrong_m
    )


class Rendezvous:
    """Guidance of the receiver until the target is its own. The guidance methods are
    ``flight.pilot.Guidance``.

    Args:
        peer: the sender's newest Status; asked only once there is one.
        now_ns: role clock.
        shows: the sender, where common views may carry the pose.
    """

    def __init__(
        self,
        config: MissionConfig,
        camera: CameraModel,
        mount: Mount,
        layout: MarkerLayout,
        marker: MarkerView,
        peer: Callable[[], Status],
        now_ns: Callable[[], int],
        shows: RoleRig | None = None,
    ) -> None:
        self._config = config
        self.fence = config.fence
        self._shows = shows
        self._camera = camera
        self._mount = mount
        self._side_m = max(marker.side_m for marker in layout.markers)
        self._marker = marker
        self._peer = peer
        self._now_ns = now_ns
        self._viewpoint: Viewpoint | None = None
        self._search_began_ns = 0
        # of the sender's reported position, once its marker was measured
        self._shift_n_m: Vec3 | None = None
        # how far below the horizon the camera looks
        self._steepness_rad = math.asin(float(mount.T_b_c.R[2, 2]))
        self.tilt = Tilt()

    @property
    def viewpoint(self) -> Viewpoint:
        assert self._viewpoint is not None, "there is no way to a viewpoint before one is planned"
        return self._viewpoint

    def plan(self, target: Target) -> Viewpoint | NoViewpoint:
        """Plan the viewpoint for the geometry the sender reports now; a found one is flown to from
        now on.
        """
        R_h_v = levelled(target.gravity_v, self._mount.T_b_v.R)
        scene = ViewpointScene(
            target_h_m=R_h_v @ np.array(target.point_v_m),
            marker_normal_h=R_h_v[:, 2],
            marker_side_m=self._side_m,
            body_h_m=R_h_v @ self._mount.T_b_v.inverse().t,
            body_radius_m=0.5 * self._config.separation.horizontal_m,
            target_radius_m=self._config.target.half_size_m,
        )
        tilt_h = np.array(from_heading(self.tilt.down_n, -self._peer().yaw_rad))
        config = self._config
        ground = self._ground(R_h_v, scene.body_h_m)
        plan = plan_viewpoint(
            scene,
            self._camera,
            self._mount.T_b_c,
            config.rendezvous,
            config.separation,
            tilt_h,
            ground,
        )
        if isinstance(plan, Viewpoint):
            self._viewpoint = plan
        return plan

    def _ground(self, R_h_v: Floats, body_h_m: Floats) -> CommonGround | None:
        """Return what the sender's keyframes show of the ground: it has flown on since."""
        if self._shows is None:
            return None
        peer = self._peer()
        T_v_c = self._shows.mount.T_v_c
        flown_h = from_heading(scale(peer.velocity_n_mps, _SHOWN_S), -peer.yaw_rad)
        T_h_c = Pose(R_h_v @ T_v_c.R, R_h_v @ T_v_c.t - np.array(flown_h))
        down_m = float(body_h_m[2]) - peer.position_n_m[2]
        farthest_m = self._config.rendezvous.max_range_m
        return CommonGround(self._shows.camera, T_h_c, down_m, farthest_m)

    # --- stand-off and search: by the positions both drones report

    def to_stand_off(self, state: VehicleState) -> VelocitySetpoint:
        """Lead to where the marker faces D2, in the middle of the image, if both positions are
        right.

        That is not on the viewpoint's side: with positions off by a metre the marker would be seen
        edge-on there.
        """
        place, yaw = self._facing_marker(self.stand_off_m)
        return self._by_position(place, state, yaw)

    def at_stand_off(self, state: VehicleState) -> bool:
        off_m = norm(subtract(self._facing_marker(self.stand_off_m)[0], state.position_n_m))
        return off_m < self._config.rendezvous.stand_off_tolerance_m

    def begin_search(self) -> None:
        self._search_began_ns = self._now_ns()

    def search(self, state: VehicleState) -> VelocitySetpoint:
        """Come in as near as the marker wants; look to and fro, wider as time goes, and slide
        outward and back.

        It comes in along the camera's axis, through the space it has looked into: a marker that is
        in D2's way, or near it, shows before D2 is there. Nowhere else does it come nearer: the
        positions may be wrong by more than is left. A drone that is nearly above the other sees it
        only from farther out.
        """
        rendezvous = self._config.rendezvous
        searching_s = (self._now_ns() - self._search_began_ns) * 1e-9
        from_m = self.stand_off_m
        to_m = self._search_from_m()
        place, yaw = self._facing_marker(max(to_m, from_m - _COME_IN_MPS * searching_s))
        searched_s = max(0.0, searching_s - (from_m - to_m) / _COME_IN_MPS - _SETTLE_S)
        turn = (
            math.radians(rendezvous.search_turn_deg)
            * min(1.0, 0.3 * searched_s)
            * math.sin(_TURN * searched_s)
        )
        back_m = _swing(
            max(rendezvous.search_slide_m, rendezvous.positions_within_m), _SLIDE * searched_s
        )
        up_m = _swing(rendezvous.heights_within_m, _CLIMB * searched_s)
        place = self._within_fence(add(place, from_heading((-back_m, 0.0, -up_m), yaw)))
        return self._by_position(place, state, yaw + turn)

    def hold_off(self, state: VehicleState) -> VelocitySetpoint:
        """Wait where the marker must be in the middle of the image, and near enough to be found."""
        place, yaw = self._facing_marker(self._search_from_m())
        return self._by_position(place, state, yaw)

    def note_seen(self, state: VehicleState, marker_n_m: Vec3) -> None:
        """The marker, from the camera: from here on the sender is where this says, and not where it
        reports to be.
        """
        self._shift_n_m = subtract(marker_n_m, self._reported(state, (0.0, 0.0, 0.0)))

    def _reported(self, state: VehicleState, shift_n_m: Vec3) -> Vec3:
        """The way from the camera to the marker by reported positions, with the sender's
        shifted.
        """
        peer = self._peer()
        own = add(state.position_n_m, from_heading(_vec3(self._mount.T_b_c.t), yaw_of(state.q_n_b)))
        marker = add(peer.position_n_m, from_heading(_vec3(self._mount.T_b_v.t), peer.yaw_rad))
        return subtract(add(marker, shift_n_m), own)

    @property
    def stand_off_m(self) -> float:
        """The least distance by reported positions; nearer once the marker has told what those are
        worth.
        """
        return (
            stand_off_m(self._config)
            if self._shift_n_m is None
            else self._config.rendezvous.stand_off_m
        )

    def _search_from_m(self) -> float:
        """Return how far from the marker the search is.

        Its side has enough pixels there, and no nearer than need be.
        """
        findable_m = 0.5 * (self._camera.fx + self._camera.fy) * self._side_m / _FINDABLE_PX
        return min(self.stand_off_m, max(self._config.rendezvous.stand_off_m, findable_m))

    def _facing_marker(self, distance_m: float) -> tuple[Vec3, float]:
        """The place from which the marker is this far along the camera's axis, and the yaw
        there.
        """
        peer = self._peer()
        steepness = self._steepness_rad
        height_m = distance_m * math.sin(steepness)
        separation = self._config.separation
        # A camera that looks steeply down would have D2 throw its air onto D1.
        clear_m = separation.wash_m + separation.wash_per_m * abs(height_m)
        level_m = max(distance_m * math.cos(steepness), clear_m)
        normal_b = self._mount.T_b_v.R[:, 2]  # of the plate, in D1's body
        facing = math.hypot(float(normal_b[0]), float(normal_b[1]))
        ahead, right = (
            (float(normal_b[0]) / facing, float(normal_b[1]) / facing)
            if facing > 0.1
            else (-1.0, 0.0)
        )
        offset = from_heading((level_m * ahead, level_m * right, -height_m), peer.yaw_rad)
        place = add(peer.position_n_m, offset)
        place = place if self._shift_n_m is None else add(place, self._shift_n_m)
        return self._within_fence(place), bearing(scale(offset, -1.0))

    def _within_fence(self, place_n_m: Vec3) -> Vec3:
        """The nearest place that is inside the fence however wrong this drone's own position is."""
        guard = self._config.guard
        rendezvous = self._config.rendezvous
        if self.fence.confines:
            return self.fence.nearest(place_n_m)
        radius_m = guard.fence_radius_m - rendezvous.positions_within_m
        return within_fence(place_n_m, radius_m, guard.fence_height_m - rendezvous.heights_within_m)

    def _by_position(
        self, place_n_m: Vec3, state: VehicleState, yaw_rad: float
    ) -> VelocitySetpoint:
        config = self._config
        answer = Answer(
            config.rendezvous.gain_per_s,
            _TRANSIT_MPS,
            config.follow.response_s,
            config.max_accel_mps2,
        )
        error = self.fence.towards(place_n_m, state.position_n_m)
        velocity = approach(error, state.velocity_n_mps, self._peer().velocity_n_mps, answer)
        return VelocitySetpoint(velocity, yaw_rad)

    # --- approach: by the marker alone

    def to_viewpoint(self, state: VehicleState) -> VelocitySetpoint:
        """Close in on the planned place; when the marker was not seen for too long, back off to see
        it again.
        """
        relative = self._marker.predict(self._now_ns())
        peer = self._peer()
        if relative is None:
            velocity, yaw = self._back_off(state)
            return VelocitySetpoint(add(peer.velocity_n_mps, velocity), yaw)
        rendezvous = self._config.rendezvous
        sure = relative.sigma_m <= rendezvous.max_position_sigma_m
        speed = rendezvous.max_speed_mps * (1.0 if sure else _UNSURE_SHARE)
        error = self._off_viewpoint(relative.marker_n_m)
        if self.fence.obstacles:
            here = state.position_n_m
            error = self.fence.towards(add(here, error), here)
        velocity = close_in(error, peer.velocity_n_mps, rendezvous.gain_per_s, speed)
        return VelocitySetpoint(velocity, self._yaw_between(relative.marker_n_m))

    def _back_off(self, state: VehicleState) -> tuple[Vec3, float]:
        """Away from the sender, relative to it, and the yaw.

        Where the marker has told what reported positions are worth, they say where it is: D2 turns
        to it, and climbs as long as that is above what its camera has in the middle of the image.
        It never sinks: that could lead nearer.
        """
        heading = yaw_of(state.q_n_b)
        climb_mps = 0.0
        if self._shift_n_m is not None:
            way = self._reported(state, self._shift_n_m)
            heading = bearing(way)
            level_m = math.hypot(way[0], way[1])
            missing_m = level_m * math.tan(self._steepness_rad) - way[2]
            north, east, down = state.position_n_m
            room_m = down - self._within_fence((north, east, down - max(0.0, missing_m)))[2]
            climb_mps = min(_CLIMB_MPS, max(0.0, self._config.rendezvous.gain_per_s * room_m))
        return from_heading((-_BACK_OFF_MPS, 0.0, -climb_mps), heading), heading

    def at_viewpoint(self) -> bool:
        """Return whether the camera is at the viewpoint, and slow."""
        relative = self._marker.predict(self._now_ns())
        rendezvous = self._config.rendezvous
        return (
            relative is not None
            and norm(self._off_viewpoint(relative.marker_n_m)) < rendezvous.arrived_m
            and norm(relative.velocity_n_mps) < rendezvous.arrived_speed_mps
        )

    def out_of_bounds(self) -> str:
        """Return why this approach must not go on; "" while all is within its bounds."""
        relative = self._marker.predict(self._now_ns())
        rendezvous = self._config.rendezvous
        if relative is None:
            return ""
        way = relative.marker_n_m
        velocity = relative.velocity_n_mps
        distance_m = norm(way)
        closing_mps = -sum(a * b for a, b in zip(way, velocity, strict=True)) / distance_m
        separation = self._config.separation
        near = self._too_near(way, distance_m)
        if near:
            return near
        # farther off than any viewpoint the bounds of an approach are wide
        if distance_m > farthest_m(separation):
            return ""
        if closing_mps > rendezvous.max_speed_mps + _RUSHING_MPS:
            return f"closing in at {closing_mps:.1f} m/s"
        if relative.sigma_m > _UNCERTAIN * rendezvous.max_position_sigma_m:
            return f"uncertain by {relative.sigma_m:.2f} m at {distance_m:.1f} m"
        return ""

    def _too_near(self, way: Vec3, distance_m: float) -> str:
        """Return how D2 is too near to the marker, or to the air below the upper drone; ""."""
        separation = self._config.separation
        if distance_m < (1.0 + _TOO_NEAR) * separation.minimum_m:
            return f"{distance_m:.2f} m from the marker"
        middle = from_heading(_vec3(self._mount.T_b_v.t), self._peer().yaw_rad)
        to_body = np.array([subtract(way, middle)])
        beside_m = float(beside_wash_m(to_body, separation, np.array(self.tilt.down_n))[0])
        if beside_m < separation.minimum_m - separation.viewpoint_m:
            return f"in the air of the upper drone, {distance_m:.2f} m from the marker"
        return ""

    def _off_viewpoint(self, marker_n_m: Vec3) -> Vec3:
        """Return what is missing to the viewpoint, given the way from the camera to the marker."""
        return add(from_heading(self.viewpoint.camera_h_m, self._peer().yaw_rad), marker_n_m)

    def _yaw_between(self, marker_n_m: Vec3) -> float:
        """Return the yaw with which marker and target share the image."""
        to_marker = bearing(marker_n_m)
        if self._marker.target_n_m is None:
            return self._peer().yaw_rad + self.viewpoint.yaw_h_rad
        return to_marker + 0.5 * wrapped(bearing(self._marker.target_n_m) - to_marker)


def _swing(widest: float, phase_rad: float) -> float:
    """Return a way from 0 to the widest and back."""
    return 0.5 * widest * (1.0 - math.cos(phase_rad))


def _vec3(of: Floats) -> Vec3:
    x, y, z = of.tolist()
    return x, y, z
