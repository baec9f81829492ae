"""Crates with prints that repeat nowhere."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from hil.render.scene import PATTERN, Body, box, lying, model_of
from hil.world.clutter import Crate
from path.arrays import Image
from path.geometry.rotation import R_from_yaw
from path.geometry.transforms import Pose

TEXELS_PER_M = 160
LIGHT = (206.0, 204.0, 200.0)
DARK = (44.0, 46.0, 50.0)
BLOB_TEXELS = (1.5, 4.0)


@lru_cache(maxsize=512)
def crate_body(crate: Crate) -> Body:
    """Return a crate where it lies."""
    rng = np.random.default_rng([0x637274, crate.look])
    faces = [
        face._replace(
            kind=PATTERN,
            second=DARK,
            shades=_shades(
                round(TEXELS_PER_M * float(np.linalg.norm(face.e2))),
                round(TEXELS_PER_M * float(np.linalg.norm(face.e1))),
                rng,
            ),
        )
        for face in box((0.0, 0.0, 0.5 * crate.size_m[2]), crate.size_m, LIGHT)
    ]
    east, north = crate.place_m
    return lying(
        model_of(faces), Pose(R_from_yaw(crate.yaw_rad), np.array([east, north, crate.floor_m]))
    )


def _shades(rows: int, columns: int, rng: np.random.Generator) -> Image:
    """Return spots of two sizes, (rows, columns)."""
    total = np.zeros((rows, columns))
    for sigma in BLOB_TEXELS:
        layer = cv2.GaussianBlur(rng.normal(size=(rows, columns)), (0, 0), sigma)
        total += layer / max(float(layer.std()), 1e-6)
    return np.asarray(np.clip(128.0 + 70.0 * total, 0.0, 255.0), np.uint8)
