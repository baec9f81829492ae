"""Random stages of the ambiguity trial: six similar people, D1 that tracks one of them, D2 that
sees D1's marker.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import Literal

import numpy as np

from drivers.rig.parts import Mount, Rig
from flight.harness.renderer import RenderedInstant, RendererSetup, Thing
from path.arrays import Array
from path.camera.model import CameraModel
from path.geometry.rotation import R_from_rpy
from path.geometry.transforms import Pose
from path.marker.layout import MarkerLayout, single_marker
from path.messages import Role
from path.values import frozen

Case = Literal["present", "outside", "hidden"]

PEOPLE = 6
# room a person takes
PERSON_HEIGHT_M = 1.8
PERSON_RADIUS_M = 0.32
SHIRT_M = (0.88, 1.48)  # heights; the detector finds shirts
SHIRT_ACROSS_M = (-0.13, -0.065, 0.0, 0.065, 0.13)
SHIRT_HEIGHTS_M = (0.95, 1.06, 1.18, 1.30, 1.41)
MIDDLE_M = 1.18  # height of the middle of a person's shirt
LENS1 = (0.112, -0.236, 0.0006, -0.0004, 0.095)
LENS2 = (0.104, -0.221, -0.0003, 0.0007, 0.088)
CAMERAS = {
    Role.SENDER: CameraModel(1280, 720, 921.4, 922.3, 643.2, 361.1, LENS1),
    Role.RECEIVER: CameraModel(1280, 720, 918.2, 918.9, 636.4, 357.8, LENS2),
}
SIDES = 4  # D1 carries its marker at its back, left, front or right: where D2 flies
PITCH_DOWN_RAD = math.radians(22.0)
TILT_UP_RAD = math.radians(30.0)
MARKER_SIDE_M = 0.04
MIN_MARKER_PX = 16.0
MAX_INCIDENCE_RAD = math.radians(58.0)
MARGIN_PX = 8.0  # between a person that is present and the image's border
WIDEST_RAD = math.radians(20.0)  # viewpoint angle that drones that near to each other have
# nearer, D2 sees it
NARROWEST_RAD: dict[Case, float] = {"hidden": math.radians(13.0), "outside": math.radians(6.0)}
SEPARATION_M = (0.9, 1.6)  # between the cameras
FARTHEST_M = 5.3  # of the target from D1: depth ends at 6 m
# half of the width of who hides the target from D2, and at most from D1
SHOULDERS_M = (0.22, 0.33)
HEAD_M = 0.07
CROWD_M = 3.5  # around the target
# arms included; no drone flies nearer to people, seen from above
BODY_WIDTH_M = 0.75
CLEAR_M = 1.5
HOVER_TILT_RAD = math.radians(2.5)
R_W_N = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
# camera axes in the body: right, down, ahead
FORWARD = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
BACKWARD = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # plate: right, up, out
ATTEMPTS = 20_000
CROWDS = 12


@frozen
class Wanted:
    """The conditions that a stage is drawn for.

    Attributes:
        nearest_m: the nearest look-alike is this far from the target, horizontally (a range to draw
            from).
        viewpoint_rad: angle between the two lines of sight, seen from above, at any distance
            between the drones; None: the drones are 0.9 to 1.6 m apart.
        marker_side_m: large enough for where D2 is.
    """

    case: Case
    nearest_m: tuple[float, float] = (0.6, 2.0)
    viewpoint_rad: float | None = None
    marker_side_m: float = MARKER_SIDE_M


@frozen
class DrawnStage:
    """A drawn stage. The target is ``stage.things[0]``; ``side`` of D1 carries the marker."""

    stage: RenderedInstant
    side: int
    wanted: Wanted

    def T_w_c(self, role: Role) -> Pose:
        return self.stage.T_w_b[role] @ camera_mount()

    @property
    def middle_w(self) -> Array:
        """Middle of the target's body."""
        east, north, _ = self.stage.things[0].position_w_m
        return np.array([east, north, MIDDLE_M])

    @property
    def separation_m(self) -> float:
        return float(np.linalg.norm(self.T_w_c(Role.RECEIVER).t - self.T_w_c(Role.SENDER).t))

    @property
    def viewpoint_rad(self) -> float:
        """Angle between the two lines of sight to the target, seen from above."""
        (x1, y1, _), (x2, y2, _) = (self.T_w_c(role).t - self.middle_w for role in Role)
        return abs(math.remainder(math.atan2(y1, x1) - math.atan2(y2, x2), 2.0 * math.pi))

    @property
    def nearest_m(self) -> float:
        first, *others = self.stage.things
        return min(math.dist(first.position_w_m[:2], other.position_w_m[:2]) for other in others)


@cache
def camera_mount() -> Pose:
    """``T_b_c`` of both drones."""
    return Pose(R_from_rpy(0.0, -PITCH_DOWN_RAD, 0.0) @ FORWARD, np.array([0.10, 0.0, 0.02]))


@cache
def marker_mount(side: int) -> Pose:
    """``T_b_v``: 18 cm out from the middle of D1 on one side, tilted up."""
    turn = R_from_rpy(0.0, 0.0, side * 2.0 * math.pi / SIDES)
    return Pose(
        turn @ R_from_rpy(0.0, -TILT_UP_RAD, 0.0) @ BACKWARD, turn @ np.array([-0.18, 0.0, -0.06])
    )


def layout(side_m: float) -> MarkerLayout:
    """The marker as it truly is."""
    return single_marker(side_m, 0.0025 * side_m)


def setup(role: Role, side: int, marker_side_m: float) -> RendererSetup:
    """One drone's camera, and the marker on D1."""
    return RendererSetup(CAMERAS[role], camera_mount(), marker_mount(side), layout(marker_side_m))


def as_drawn(rig: Rig, scene: DrawnStage) -> Rig:
    """Return the rig as it truly is on a stage: cameras, mounts and marker are the trial's."""
    mount = Mount(camera_mount(), marker_mount(scene.side))
    sender, receiver = (replace(rig.role(role), camera=CAMERAS[role], mount=mount) for role in Role)
    return replace(rig, sender=sender, receiver=receiver, layout=layout(scene.wanted.marker_side_m))


def draw(wanted: Wanted, rng: np.random.Generator) -> DrawnStage:
    """A random stage; what people hide of each other is not looked at here, but for ``hidden``.

    Raises:
        RuntimeError: none was found.
    """
    widest = WIDEST_RAD if wanted.viewpoint_rad is None else wanted.viewpoint_rad
    narrowest = (
        NARROWEST_RAD.get(wanted.case, 0.0)
        if wanted.viewpoint_rad is None
        else wanted.viewpoint_rad
    )
    turn = rng.choice((-1.0, 1.0)) * rng.uniform(narrowest, widest)
    for _ in range(ATTEMPTS):
        drones = _drones(wanted, turn, rng)
        if drones is None:
            continue
        eyes = [drones.T_w_c(role).t for role in Role]
        for _ in range(CROWDS):
            people = _people(wanted, drones.middle_w[:2], eyes[0], eyes[1], rng)
            scene = (
                None
                if people is None
                else replace(drones, stage=replace(drones.stage, things=people))
            )
            if scene is not None and _crowd_fits(scene):
                return scene
    raise RuntimeError(f"no stage for {wanted}")


def _drones(wanted: Wanted, turn: float, rng: np.random.Generator) -> DrawnStage | None:
    """Both drones and the target alone; None when D1 does not see the target, or D2 not what it is
    to see.
    """
    target = rng.uniform(-8.0, 8.0, 2)
    azimuth = rng.uniform(0.0, 2.0 * math.pi)
    eyes = _eyes(wanted, turn, rng)
    if eyes is None:
        return None
    (reach1, height1), (reach2, height2) = eyes
    eye1 = np.array([*(target + reach1 * _toward(azimuth)), height1])
    eye2 = np.array([*(target + reach2 * _toward(azimuth + turn)), height2])
    T1 = _hover(eye1, target, rng.normal(0.0, math.radians(7.0)), rng)
    T2 = _hover(eye2, target, _aside(wanted, target, eye1, eye2, rng), rng)
    alone = (Thing("person", (float(target[0]), float(target[1]), 0.0)),)
    stage = RenderedInstant(
        {Role.SENDER: T1, Role.RECEIVER: T2}, alone, rng.uniform(0.0, 2.0 * math.pi)
    )
    scene = DrawnStage(stage, _best_side(T1, T2), wanted)
    return scene if _target_fits(scene) else None


CameraPose = tuple[float, float]  # horizontal distance from the target, height


def _eyes(
    wanted: Wanted, turn: float, rng: np.random.Generator
) -> tuple[CameraPose, CameraPose] | None:
    """Return both cameras' places, D2's turned by ``turn`` from D1's line of sight; None: too far
    aside to be near.
    """
    if wanted.viewpoint_rad is not None:
        near = rng.uniform(2.3, 2.8)
        far = rng.uniform(3.8, 4.4)
        return (near, _height(near, wanted, rng)), (far, _height(far, wanted, rng))
    reach = rng.uniform(2.4, 4.4)
    distance = rng.uniform(*SEPARATION_M)
    rise = rng.uniform(0.0, 0.8)
    if wanted.case == "hidden":  # from high up, nobody is hidden behind another
        rise = rng.uniform(0.03, 0.2)
    across = reach * math.sin(turn)
    flat = distance * math.cos(rise)
    if abs(across) >= flat:
        return None
    height = _height(reach, wanted, rng)
    behind = reach * math.cos(turn) + math.sqrt(flat * flat - across * across)
    return (reach, height), (behind, height + distance * math.sin(rise))


def _toward(azimuth: float) -> Array:
    return np.array([math.cos(azimuth), math.sin(azimuth)])


def _height(reach: float, wanted: Wanted, rng: np.random.Generator) -> float:
    """Return the height from which the target's shirt at that horizontal distance is seen from
    above by some angle.
    """
    down = (
        rng.uniform(0.03, 0.11)
        if wanted.case == "hidden"
        else rng.normal(math.radians(24.0), math.radians(4.0))
    )
    return MIDDLE_M + reach * math.tan(down)


def _facing(
    wanted: Wanted, nearest: float, bearing: float, rng: np.random.Generator
) -> list[float]:
    """Draw where everybody looks.

    Two that stand closer than they are wide stand one behind the other; who hides the target turns
    its front or back.
    """
    yaws = rng.uniform(-math.pi, math.pi, PEOPLE)
    if wanted.case == "hidden":
        yaws[1] = bearing + rng.choice((0.0, math.pi)) + rng.normal(0.0, 0.15)
    elif nearest < BODY_WIDTH_M:
        yaws[:2] = bearing + rng.choice((0.0, math.pi), 2) + rng.normal(0.0, 0.1, 2)
    return yaws.tolist()


def _people(
    wanted: Wanted, target: Array, eye1: Array, eye2: Array, rng: np.random.Generator
) -> tuple[Thing, ...] | None:
    """The target first. None when they do not fit."""
    places = [target]
    nearest = rng.uniform(*wanted.nearest_m)
    toward_eye = eye2[:2] - target
    bearing = math.atan2(toward_eye[1], toward_eye[0])
    angle = (
        bearing + rng.normal(0.0, 0.05)
        if wanted.case == "hidden"
        else rng.uniform(0.0, 2.0 * math.pi)
    )
    places.append(target + nearest * _toward(angle))
    if wanted.case == "hidden":
        narrow, broad = SHOULDERS_M
        if (
            _hidden_share(eye2, places[0], places[1], narrow) < 1.0
            or _hidden_share(eye1, places[0], places[1], broad) > 0.25
        ):
            return None
    for _ in range(60):
        if len(places) == PEOPLE:
            break
        place = target + rng.uniform(max(nearest, BODY_WIDTH_M), CROWD_M) * _toward(
            rng.uniform(0.0, 2.0 * math.pi)
        )
        if min(float(np.linalg.norm(place - other)) for other in places) >= BODY_WIDTH_M:
            places.append(place)
    if len(places) < PEOPLE:
        return None
    variants = rng.permutation(PEOPLE)
    return tuple(
        Thing("person", (float(x), float(y), 0.0), yaw, int(variant))
        for (x, y), variant, yaw in zip(
            places, variants, _facing(wanted, nearest, angle, rng), strict=True
        )
    )


def _aside(
    wanted: Wanted, target: Array, eye1: Array, eye2: Array, rng: np.random.Generator
) -> float:
    """Return by how much D2 does not look straight at the target, so that D1 is in its view too.

    Or the target is not.
    """
    to_target = target - eye2[:2]
    to_peer = eye1[:2] - eye2[:2]
    between = math.remainder(
        math.atan2(to_peer[1], to_peer[0]) - math.atan2(to_target[1], to_target[0]), 2.0 * math.pi
    )
    share = rng.uniform(0.3, 0.7) if wanted.case != "outside" else rng.uniform(1.0, 1.6)
    return share * between + rng.normal(0.0, math.radians(4.0))


def _hover(eye: Array, target: Array, aside: float, rng: np.random.Generator) -> Pose:
    """``T_w_b`` of a drone whose camera is about at ``eye`` and looks at the target, turned by
    ``aside``.
    """
    east, north = target - eye[:2]
    yaw = math.atan2(east, north) - aside
    roll, pitch = rng.normal(0.0, HOVER_TILT_RAD, 2)
    return Pose(R_W_N @ R_from_rpy(roll, pitch, yaw), eye)


def _best_side(T_w_b1: Pose, T_w_b2: Pose) -> int:
    """The side of D1 whose plate faces D2 best."""
    toward = T_w_b1.R.T @ (T_w_b2.t - T_w_b1.t)
    return int(np.argmax([float(marker_mount(side).R[:, 2] @ toward) for side in range(SIDES)]))


def _target_fits(scene: DrawnStage) -> bool:
    """Return whether D1 sees the target, D2 the marker, and D2 the target or, as wanted, not."""
    target = scene.stage.things[0]
    receiver = _view(scene, Role.RECEIVER)
    sender = _view(scene, Role.SENDER)
    if not sender.holds(target) or math.dist(sender.T_w_c.t, scene.middle_w) > FARTHEST_M:
        return False
    if not _marker_seen(scene, receiver):
        return False
    return (
        receiver.holds(target) if scene.wanted.case != "outside" else not receiver.touches(target)
    )


def _crowd_fits(scene: DrawnStage) -> bool:
    """Return whether nobody stands where a drone is, and D2 sees look-alikes."""
    others = scene.stage.things[1:]
    eyes = [scene.T_w_c(role).t for role in Role]
    if any(
        math.dist(other.position_w_m[:2], eye[:2]) < CLEAR_M for other in others for eye in eyes
    ):
        return False
    receiver = _view(scene, Role.RECEIVER)
    return sum(receiver.holds(other) for other in others) >= 2


def _hidden_share(eye: Array, target: Array, other: Array, shoulder_m: float) -> float:
    """Return about the share of the target's shirt that another person hides from a camera.

    A column, and a narrow head.
    """
    (x, y, z), (ox, oy) = eye.tolist(), other.tolist()
    tx, ty = target.tolist()
    reach = math.hypot(tx - x, ty - y)
    blocked = 0
    for aside in SHIRT_ACROSS_M:
        dx = tx - aside * (ty - y) / reach - x
        dy = ty + aside * (tx - x) / reach - y
        share = ((ox - x) * dx + (oy - y) * dy) / (dx * dx + dy * dy)
        past = math.hypot(x + share * dx - ox, y + share * dy - oy)
        for height in SHIRT_HEIGHTS_M:
            up = z + share * (height - z)
            blocked += (
                0.0 < share < 1.0
                and past < (shoulder_m if up < SHIRT_M[1] else HEAD_M)
                and up < 1.7
            )
    return blocked / (len(SHIRT_HEIGHTS_M) * len(SHIRT_ACROSS_M))


def _view(scene: DrawnStage, role: Role) -> StageCamera:
    return StageCamera(scene.T_w_c(role), CAMERAS[role])


@frozen
class StageCamera:
    """A camera in the world."""

    T_w_c: Pose
    camera: CameraModel

    def pixel(self, point_w: Array) -> tuple[float, float]:
        x, y, z = self.T_w_c.inverse().apply(point_w).tolist()
        return self.camera.project_point((x, y, z))

    def holds(self, thing: Thing) -> bool:
        """Return whether all of a person's shirt is in the image."""
        corners = self.T_w_c.inverse().apply(_room(thing))
        return all(self.camera.sees((x, y, z), MARGIN_PX) for x, y, z in corners.tolist())

    def touches(self, thing: Thing) -> bool:
        """Return whether any of the person is in the image."""
        low = np.array(thing.position_w_m)
        high = np.array(thing.position_w_m)
        high[2] += PERSON_HEIGHT_M
        across = self.T_w_c.R[:, 0] * PERSON_RADIUS_M
        line = np.linspace(low, high, 7)
        points = self.T_w_c.inverse().apply(np.concatenate((line - across, line, line + across)))
        return any(self.camera.sees((x, y, z)) for x, y, z in points.tolist())


def _room(thing: Thing) -> Array:
    """Corners (8, 3) of the room that a person's shirt takes."""
    r = PERSON_RADIUS_M
    offsets = np.array([[x, y, z] for x in (-r, r) for y in (-r, r) for z in SHIRT_M])
    return np.array(thing.position_w_m) + offsets


def _marker_seen(scene: DrawnStage, receiver: StageCamera) -> bool:
    T_w_v = scene.stage.T_w_b[Role.SENDER] @ marker_mount(scene.side)
    perception = receiver.T_w_c.t - T_w_v.t
    distance = float(np.linalg.norm(perception))
    facing = float(T_w_v.R[:, 2] @ perception) / distance
    x, y, z = receiver.T_w_c.inverse().apply(T_w_v.t).tolist()
    return (
        facing > math.cos(MAX_INCIDENCE_RAD)
        and receiver.camera.sees((x, y, z), 40.0)
        and receiver.camera.fx * scene.wanted.marker_side_m / z >= MIN_MARKER_PX
    )
