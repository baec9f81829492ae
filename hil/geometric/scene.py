"""The geometric perception's picture of one instant: what the truth puts where in one camera's
image.
"""

from __future__ import annotations

from dataclasses import field
from functools import cache, lru_cache

import numpy as np

from hil.geometric import kernels, targets
from hil.render.bodies.kinds import BOXES
from hil.render.bodies.walking import boxes_of_a_walker
from hil.render.scene import SOLID, Model, drone, marked_drone
from hil.world.clutter import Crate
from hil.world.gait import OWN_PHASE
from hil.world.snapshot import AS_IT_IS, ObjectTruth, Snapshot, TargetKind
from path.arrays import Array
from path.camera.kernels import lens_of
from path.camera.model import CameraModel
from path.geometry.rotation import R_from_yaw
from path.geometry.transforms import Pose
from path.marker.layout import MarkerLayout
from path.messages import Role, Vec3
from path.values import frozen, value

FACES_OF_A_BOX = 6
# of a stride, as finely as the geometry tells people's postures apart
POSTURES = 64
SPEED_STEP_MPS = 0.02


@cache
def parts_of(kind: TargetKind, stretch: Vec3 = AS_IT_IS) -> Array:
    """Return the boxes of an object, (b, 15): centre, half sides, axes. Shared: do not change them.

    A person's are around a whole walk.
    """
    rows = [
        [*centre, *(0.5 * side for side in size), *np.eye(3).ravel()]
        for centre, size, _ in BOXES[kind]
    ]
    return _stretched(np.array(rows, float), stretch)


def _stretched(parts: Array, stretch: Vec3) -> Array:
    """Return boxes made larger; those of turned limbs are alike in all directions."""
    grown = parts.copy()
    grown[:, 0:3] *= stretch
    grown[:, 3:6] *= stretch
    return grown


def drone_parts(
    T_b_v: Pose,
    layout: MarkerLayout,
    *,
    marked: bool,
) -> Array:
    """Boxes of a drone in body FRD, (d, 15), with the backs of its marker plates when it carries
    them.
    """
    return _boxes(marked_drone(T_b_v, layout, hidden=False) if marked else drone())


def _boxes(model: Model) -> Array:
    """The boxes a model's solid faces make up: six each, in opposite pairs."""
    corners = model.corners[model.kinds == SOLID].reshape(-1, FACES_OF_A_BOX, 9)
    middles = corners[:, :, 0:3] + 0.5 * (corners[:, :, 3:6] + corners[:, :, 6:9])
    # (d, 3, 3): half sides as vectors, one a row
    across = 0.5 * (middles[:, 0::2] - middles[:, 1::2])
    half = np.linalg.norm(across, axis=2)
    axes = np.swapaxes(across / half[:, :, None], 1, 2)
    return np.concatenate((middles.mean(axis=1), half, axes.reshape(-1, 9)), axis=1)


@frozen
class CameraSetup:
    """The constants of one camera between its frames."""

    role: Role
    camera: CameraModel
    T_b_c: Pose
    T_b_v: Pose
    layout: MarkerLayout
    lens: Array = field(init=False)
    other: Array = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "lens", lens_of(self.camera))
        marked = self.role is not Role.SENDER
        object.__setattr__(self, "other", drone_parts(self.T_b_v, self.layout, marked=marked))


NO_DRONE = np.empty((0, 15))
STILL = Pose(np.eye(3), np.zeros(3))


@value
class Placed:
    """The bodies of one instant before one camera; columns as in ``hil.geometric.kernels``. Last
    is what is no object: the other drone and all obstacles, as one body.

    ``per_object``: boxes of every object.
    """

    boxes: Array
    extents: Array
    frame: Array
    per_object: int


def place(
    setup: CameraSetup,
    snapshot: Snapshot,
    later_s: float = 0.0,
) -> Placed:
    """Put the snapshot's objects, and the other drone, before the camera, as
    ``Snapshot.carried_on`` by ``later_s``.
    """
    poses = {
        role: truth.T_w_b_after(later_s) if later_s else truth.T_w_b
        for role, truth in snapshot.drones.items()
    }
    own = poses[setup.role]
    others = [T_w_b for role, T_w_b in poses.items() if role is not setup.role]
    other, parts = (others[0], setup.other) if others else (STILL, NO_DRONE)
    rows = [
        (*(thing.position_after(later_s) if later_s else thing.position_w_m), thing.yaw_rad)
        for thing in snapshot.objects
    ]
    things = np.array(rows, float).reshape(-1, 4)
    count = len(things)
    shape = parts_of(snapshot.kind, snapshot.stretch)
    per_object = len(shape)
    if snapshot.kind == "person" and count > 0:
        shape = np.concatenate(
            [_walking(thing, later_s, snapshot.stretch) for thing in snapshot.objects]
        )
    standing = boxes_of(snapshot.obstacles)
    boxes = np.empty((count * per_object + len(parts) + len(standing), kernels.BOX_COLUMNS))
    extents = np.empty((count + 1, kernels.EXTENT_COLUMNS))
    frame = np.empty(kernels.FRAME_COLUMNS)
    kernels.place(
        own.R, own.t, setup.T_b_c.R, setup.T_b_c.t, setup.lens, things, shape, other.R, other.t, parts,
        standing, boxes, extents, frame,
    )  # fmt: skip
    return Placed(boxes, extents, frame, per_object)


@cache
def boxes_of(obstacles: tuple[Crate, ...]) -> Array:
    """Return boxes of the world, (m, 15) as ``parts_of``. Shared: do not change them."""
    rows = [
        [
            *each.place_m,
            each.floor_m + 0.5 * each.size_m[2],
            *(0.5 * side for side in each.size_m),
            *R_from_yaw(each.yaw_rad).ravel(),
        ]
        for each in obstacles
    ]
    return np.array(rows, float).reshape(-1, 15)


def _walking(
    thing: ObjectTruth,
    later_s: float,
    stretch: Vec3,
) -> Array:
    """Return the boxes of a person in their gait."""
    strides = thing.strides_after(later_s) + OWN_PHASE * thing.object_id
    return _posture(
        round(strides * POSTURES) % POSTURES,
        round(thing.speed_mps / SPEED_STEP_MPS),
        stretch,
    )


@lru_cache(2048)
def _posture(
    number: int,
    speed: int,
    stretch: Vec3,
) -> Array:
    return _stretched(
        np.array(boxes_of_a_walker(number / POSTURES, speed * SPEED_STEP_MPS)), stretch
    )


def outlines(setup: CameraSetup, placed: Placed) -> Array:
    """Return the visible outline of each object, (n, SEEN_COLUMNS), without noise."""
    seen = np.empty((len(placed.extents) - 1, targets.SEEN_COLUMNS))
    targets.outlines(placed.boxes, placed.extents, placed.per_object, setup.lens, seen)
    return seen
