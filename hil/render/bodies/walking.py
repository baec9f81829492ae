"""People who walk: the body of ``hil.render.bodies.people`` with legs that bend at hip and knee,
and arms that swing.

Feet stay where they stand while the body passes over them (``hil.world.gait``), and each arm swings
against its leg. A posture depends on nothing but who it is, how many strides they have made, and
how fast they go.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import numpy as np

from hil.render.bodies.people import ARM_PARTS, LEG_PARTS, PARTS, SHOE_PARTS, SWUNG_M, build, person
from hil.render.scene import SOLID, Color, Face, Model, model_of
from hil.world.gait import OWN_PHASE, foot_at, reach_m
from path.arrays import Array, Whole
from path.values import frozen

# above the ground
HIP_M = 0.901
ANKLE_M = 0.093
SHOULDER_M = 1.41
KNEE_SHARE = 7.0 / 15.0  # of the leg, from the hip down: between two rows of the trousers' pattern
STRETCHED = 0.997  # of the leg, at most
ARM_SHARE = 0.87  # of the legs' angle
FACES_OF_A_BOX = 6
# the left one; the right one follows
TRUNK = 0
THIGH = 1
SHIN = 3
SHOE = 5
ARM = 7
LIMBS = 9
SIGNS = np.array(np.meshgrid(*((-1.0, 1.0),) * 3)).reshape(3, -1).T
Vec3 = tuple[float, float, float]


@frozen(eq=False)
class Walker:
    """One person's body, standing upright with its arms down, and to which limb each of its faces
    belongs.

    ``points``: (n, 3, 3): corner and both sides of each face.
    """

    model: Model
    limbs: Whole
    points: Array
    build: Array


@cache
def walker(variant: int) -> Walker:
    """The person that ``hil.render.bodies.people.person`` is. Shared: do not change it."""
    scale = build(variant)
    faces: list[Face] = []
    limbs: list[int] = []  # of each face
    standing = _faces_of(person(variant))
    for number in range(len(PARTS)):
        own = [next(standing) for _ in range(FACES_OF_A_BOX)]
        if number in LEG_PARTS:
            side = LEG_PARTS.index(number)
            thigh, shin = _cut_at_the_knee(own)
            faces += [*thigh, *shin]
            limbs += [THIGH + side] * len(thigh) + [SHIN + side] * len(shin)
            continue
        back = np.array([-SWUNG_M.get(number, 0.0) * scale[0], 0.0, 0.0])
        faces += [face._replace(corner=face.corner + back) for face in own]
        limbs += [_limb_of(number)] * FACES_OF_A_BOX
    model = model_of(faces)
    return Walker(model, np.array(limbs), model.corners.reshape(-1, 3, 3), scale)


def _faces_of(model: Model) -> Iterator[Face]:
    shades = iter(model.shades)
    for corner, color, kind, second in zip(
        model.corners,
        model.colors,
        model.kinds,
        model.seconds,
        strict=True,
    ):
        table = None if kind == SOLID else next(shades)
        yield Face(
            corner[:3],
            corner[3:6],
            corner[6:],
            tuple(color),
            int(kind),
            tuple(second),
            table,
        )


def _cut_at_the_knee(leg: list[Face]) -> tuple[list[Face], list[Face]]:
    """Thigh and shin of a leg, each a whole box."""
    thigh: list[Face] = []
    shin: list[Face] = []
    flat = [face for face in leg if face.e1[2] == face.e2[2] == 0.0]
    for face in leg:
        if face.e1[2] == face.e2[2] == 0.0:
            continue
        # the side that is upright, and the axis of the table along it
        along = 1 if face.e1[2] != 0.0 else 2
        edge = face[along]
        table = face.shades
        assert isinstance(edge, np.ndarray) and table is not None
        falls = edge[2] < 0.0
        share = KNEE_SHARE if falls else 1.0 - KNEE_SHARE
        cells = round(share * table.shape[2 - along])
        first = table[:, :cells] if along == 1 else table[:cells]
        second = table[:, cells:] if along == 1 else table[cells:]
        name = f"e{along}"
        before = face._replace(**{name: edge * share, "shades": first})
        after = face._replace(
            **{name: edge * (1.0 - share), "shades": second, "corner": face.corner + edge * share}
        )
        thigh.append(before if falls else after)
        shin.append(after if falls else before)
    top, bottom = sorted(flat, key=lambda face: -face.corner[2])
    knee = top.corner[2] + KNEE_SHARE * (bottom.corner[2] - top.corner[2])
    thigh += [top, _cap(bottom, knee)]
    shin += [bottom, _cap(top, knee)]
    return thigh, shin


def _cap(face: Face, height_m: float) -> Face:
    """A face of the same outline at another height, in one colour."""
    return face._replace(corner=np.array([*face.corner[:2], height_m]), kind=SOLID, shades=None)


def walking(
    variant: int,
    strides: float,
    speed_mps: float,
) -> Model:
    """A person in their gait: x forward, z up, origin on the ground below the hips.

    Args:
        strides: made so far; the left foot lands, farthest ahead, at whole ones.
        speed_mps: negative, when they walk backward; standing, feet are side by side.
    """
    body = walker(variant)
    turn, shift = _now(body.build, strides, speed_mps)
    points = np.einsum("nij,nkj->nki", turn[body.limbs], body.points)
    points[:, 0] += shift[body.limbs]
    return replace(body.model, corners=points.reshape(-1, 9))


def walking_as(
    number: int,
    variant: int,
    strides: float,
    speed_mps: float,
) -> Model:
    """The person with a number among others: nobody walks in step."""
    return walking(variant, strides + OWN_PHASE * number, speed_mps)


def boxes_around_a_walker(speed_mps: float) -> tuple[tuple[Vec3, Vec3, Color], ...]:
    """Centre, size and colour of upright boxes around the limbs of one who walks, as far as these
    swing.

    The trunk and the arms are as high as those of one who stands.
    """
    reach = reach_m(speed_mps)
    turn, shift = _posture(np.ones(3), ((reach, 0.0), (-reach, 0.0)), reach, 1.0)
    shift[[TRUNK, ARM, ARM + 1], 2] -= shift[TRUNK, 2]
    boxes: list[tuple[Vec3, Vec3, Color]] = []
    for limb, center, size, color in _boxes():
        corners = center + 0.5 * size * SIGNS
        points = corners @ turn[limb].T + shift[limb]
        low = points.min(axis=0)
        high = points.max(axis=0)
        middle = 0.5 * (low + high)
        sides = high - low
        boxes.append((_tuple(middle), _tuple(sides), color))
    return tuple(boxes)


def boxes_of_a_walker(strides: float, speed_mps: float) -> Array:
    """Boxes around each limb in its place, (b, 15): centre, half sides, axes by columns; as
    ``walking``.
    """
    turn, shift = _now(np.ones(3), strides, speed_mps)
    rows = [
        np.concatenate((turn[limb] @ center + shift[limb], 0.5 * size, turn[limb].ravel()))
        for limb, center, size, _ in _boxes()
    ]
    return np.array(rows)


def _now(
    scale: Array,
    strides: float,
    speed_mps: float,
) -> tuple[Array, Array]:
    """Return how each limb is turned and moved, as ``_posture``."""
    feet = foot_at(strides, speed_mps), foot_at(strides + 0.5, speed_mps)
    return _posture(scale, feet, reach_m(speed_mps), math.cos(2.0 * math.pi * strides))


def _boxes() -> Iterator[tuple[int, Array, Array, Color]]:
    """The limb, centre, size and first colour of each box of an upright body."""
    for number, part in enumerate(PARTS):
        center = np.array(part.center)
        size = np.array(part.size)
        limb = _limb_of(number)
        if number in LEG_PARTS:
            share = np.array([1.0, 1.0, KNEE_SHARE])
            rise = np.array([0.0, 0.0, 0.5 * (1.0 - KNEE_SHARE) * size[2]])
            yield limb, center + rise, size * share, part.colors[0]
            rise = np.array([0.0, 0.0, -0.5 * KNEE_SHARE * size[2]])
            share = np.array([1.0, 1.0, 1.0 - KNEE_SHARE])
            yield limb + SHIN - THIGH, center + rise, size * share, part.colors[0]
            continue
        yield limb, center - np.array([SWUNG_M.get(number, 0.0), 0.0, 0.0]), size, part.colors[0]


def _limb_of(number: int) -> int:
    """Return the limb that one of ``PARTS`` belongs to; of a leg, its thigh."""
    for parts, first in ((SHOE_PARTS, SHOE), (LEG_PARTS, THIGH), (ARM_PARTS, ARM)):
        if number in parts:
            return first + parts.index(number) % 2
    return TRUNK


def _tuple(vector: Array) -> Vec3:
    x, y, z = vector.tolist()
    return x, y, z


def _posture(
    scale: Array,
    feet: tuple[tuple[float, float], tuple[float, float]],
    reach: float,
    left_ahead: float,
) -> tuple[Array, Array]:
    """Return how each limb is turned and moved, (LIMBS, 3, 3) and (LIMBS, 3).

    Args:
        feet: left and right, how far ahead and above the ground.
        reach: of a foot ahead of the hips, at most.
        left_ahead: -1..1, how far the left leg is ahead, for the arms.
    """
    turn = np.tile(np.eye(3), (LIMBS, 1, 1))
    shift = np.zeros((LIMBS, 3))
    tall = float(scale[2])
    hip = tall * HIP_M
    shoulder = tall * SHOULDER_M
    leg = hip - tall * ANKLE_M
    thigh = KNEE_SHARE * leg
    shin = (1.0 - KNEE_SHARE) * leg
    over = math.sqrt((STRETCHED * leg) ** 2 - reach**2)  # of the hips above the ankles
    shift[TRUNK, 2] = sunk = over - leg
    swing = ARM_SHARE * math.asin(reach / leg) * left_ahead
    for side, (ahead, above) in enumerate(feet):
        down = over - above
        far = math.hypot(ahead, down)
        bent = math.acos(min(1.0, (thigh**2 + far**2 - shin**2) / (2.0 * thigh * far)))
        first = math.atan2(ahead, down) + bent
        knee_x = thigh * math.sin(first)
        knee_down = thigh * math.cos(first)
        second = math.atan2(ahead - knee_x, down - knee_down)
        _hinge(turn, shift, THIGH + side, first, (0.0, hip), (0.0, hip + sunk))
        _hinge(
            turn,
            shift,
            SHIN + side,
            second,
            (0.0, hip - thigh),
            (knee_x, hip + sunk - knee_down),
        )
        shift[SHOE + side] = ahead, 0.0, above
        _hinge(
            turn,
            shift,
            ARM + side,
            swing if side else -swing,
            (0.0, shoulder),
            (0.0, shoulder + sunk),
        )
    return turn, shift


def _hinge(
    turn: Array,
    shift: Array,
    limb: int,
    forward_rad: float,
    joint: tuple[float, float],
    moved: tuple[float, float],
) -> None:
    """Turn a limb about a joint (x, z), what hangs below it forward, and put the joint where it has
    moved.
    """
    c = math.cos(forward_rad)
    s = math.sin(forward_rad)
    turn[limb] = ((c, 0.0, -s), (0.0, 1.0, 0.0), (s, 0.0, c))
    shift[limb] = np.array([moved[0], 0.0, moved[1]]) - turn[limb] @ np.array(
        [joint[0], 0.0, joint[1]]
    )
