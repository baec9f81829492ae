"""The shapes of what can be tracked: boxes for the geometry, models for the cameras. x forward, z
up.

The frame of a car or a person lies on the ground below its middle, that of a drone in its middle.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np

from hil.render.bodies.people import VARIANTS
from hil.render.bodies.walking import boxes_around_a_walker, walking_as
from hil.render.scene import (
    CAR_BOXES,
    FRAME,
    GAP_M,
    MOTOR,
    ORANGE,
    Color,
    Model,
    box,
    car,
    model_of,
)
from hil.world.snapshot import AS_IT_IS, ObjectTruth, TargetKind

Vec3 = tuple[float, float, float]
Boxes = tuple[tuple[Vec3, Vec3, Color], ...]

WALKING_MPS = 0.3  # what the rigs' people walk at
_ARM_M = 0.12
_HULL_M = (0.16, 0.11, 0.05)
DRONE_HULL: Boxes = (
    # centre, size, colour
    ((0.0, 0.0, 0.0), _HULL_M, ORANGE),
    ((0.0, 0.0, 0.037), (0.09, 0.06, 0.020), ORANGE),
)
DRONE_LIMBS: Boxes = (
    # arms point ahead, back and to the sides
    *(
        ((sign * (0.5 * (_HULL_M[0] / 2 + GAP_M + _ARM_M)), 0.0, 0.0), (_ARM_M - _HULL_M[0] / 2 - GAP_M, 0.02, 0.012),
         FRAME)
        for sign in (1.0, -1.0)
    ),
    *(
        ((0.0, sign * (0.5 * (_HULL_M[1] / 2 + GAP_M + _ARM_M)), 0.0), (0.02, _ARM_M - _HULL_M[1] / 2 - GAP_M, 0.012),
         FRAME)
        for sign in (1.0, -1.0)
    ),
    *(
        ((x, y, 0.010), (0.034, 0.034, 0.040), MOTOR)
        for x, y in ((_ARM_M + 0.018, 0.0), (-_ARM_M - 0.018, 0.0), (0.0, _ARM_M + 0.018), (0.0, -_ARM_M - 0.018))
    ),
)  # fmt: skip

BOXES: Mapping[TargetKind, Boxes] = {
    "car": CAR_BOXES,
    "person": boxes_around_a_walker(WALKING_MPS),
    "drone": DRONE_HULL,
}
"""The bodies that the geometry reckons with. A drone's arms and motors are not in it: they are of
another colour than its hull, and the colour detector hardly ever has them in its box. A person's
are around their limbs where their steps are longest: arms and legs that swing stay within them."""


def model_of_thing(
    kind: TargetKind,
    thing: ObjectTruth,
    stretch: Vec3 = AS_IT_IS,
) -> Model:
    """Return the body that cameras see of an object now: people are not quite alike, and in their
    gait.
    """
    model = _model_of_kind(kind, thing)
    return (
        model
        if stretch == AS_IT_IS
        else replace(model, corners=model.corners * np.tile(stretch, 3))
    )


def _model_of_kind(kind: TargetKind, thing: ObjectTruth) -> Model:
    if kind == "car":
        return car()
    if kind == "drone":
        return _micro_uav()
    return walking_as(thing.object_id, thing.object_id % VARIANTS, thing.strides, thing.speed_mps)


@cache
def _micro_uav() -> Model:
    return model_of(
        [
            face
            for center, size, color in (*DRONE_HULL, *DRONE_LIMBS)
            for face in box(center, size, color)
        ]
    )
