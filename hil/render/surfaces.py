"""Surfaces that give a stereo camera with a projected pattern no depth: black ones, and paint that
mirrors the sun.

Black swallows the pattern. A surface that mirrors the sun into the camera is white in both of its
images, without anything to match. Both are shares of such a surface, in patches: assumed, not
measured on a D415.
"""

from __future__ import annotations

import math

import numpy as np

from hil.render.primitives import COLOR, INVERSE_Z, KIND, LIGHT, OVER_U, OVER_V, VEHICLE
from hil.render.scene import SOLID
from hil.render.sensor import SensorNoise
from path.arrays import Array, Singles, Whole

# mean of B, G and R under full light up to which a surface is black: tyres, not arms or shoes
BLACK = 50.0
# from the mirrored sun, up to which paint gleams: that of models is not flat
GLEAM_RAD = math.radians(15.0)


def lost_shares(
    faces: Array,
    tags: Whole,
    count: int,
    sun_c: Array,
    noise: SensorNoise,
) -> Singles | None:
    """Return the share of each face (count,) that has no depth; None where none loses any.

    Args:
        faces, tags, count: as of ``primitives.add_body``. sun_c: (3,) towards the sun, in the
            camera.
    """
    if count == 0 or not (noise.depth_dark_lost or noise.depth_gleam_lost):
        return None
    faces = faces[:count]
    solid = tags[:count, KIND] == SOLID
    level = faces[:, COLOR : COLOR + 3].mean(axis=1) / np.maximum(faces[:, LIGHT], 1e-6)
    shares = np.where(solid & (level < BLACK), noise.depth_dark_lost, 0.0)
    if noise.depth_gleam_lost:
        painted = solid & (tags[:count, VEHICLE] == 1)
        gleams = _mirrored(faces[painted]) @ (sun_c / np.linalg.norm(sun_c)) > math.cos(GLEAM_RAD)
        shares[painted] = np.maximum(shares[painted], np.where(gleams, noise.depth_gleam_lost, 0.0))
    return shares.astype(np.float32) if shares.any() else None


def _mirrored(faces: Array) -> Array:
    """Directions (n, 3) to what the camera sees in the middle of each face, if it were a mirror."""
    rows = np.stack([faces[:, first : first + 3] for first in (OVER_U, OVER_V, INVERSE_Z)], axis=1)
    middles = np.linalg.solve(rows, np.array([0.5, 0.5, 1.0])[:, None])[..., 0]
    sight = middles / np.linalg.norm(middles, axis=1, keepdims=True)
    away = faces[:, INVERSE_Z : INVERSE_Z + 3]
    away = away / np.linalg.norm(away, axis=1, keepdims=True)
    return sight - 2.0 * np.sum(sight * away, axis=1, keepdims=True) * away
