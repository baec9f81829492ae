"""The sensor's share of an image: optical blur, shot and read noise, noise and holes of the depth,
quantisation.
"""

# pyright: reportMissingParameterType=false
# Kernels are typed by what they are first called with; their docstrings say what that is.

from __future__ import annotations

import math
from dataclasses import fields
from typing import Annotated

import cv2
import numpy as np
from numpy.typing import NDArray

from hil.render.kernels import INTERIOR
from hil.render.primitives import VEHICLE
from path.arrays import Singles
from path.bounds import Bounds
from path.compiled import inner, kernel
from path.values import frozen

F = np.float32
POOL_MARGIN = 256  # the noise of a frame is a window of a fixed pool; this many positions each way
POOL_UNIT = 32.0  # integer value of one standard deviation in a pool
CHANNEL_STEP = 83  # the channels' windows lie this far apart
JUMP = F(0.03)  # relative step in depth that a stereo camera has trouble at
MASK = (1 << 64) - 1


@frozen
class SensorNoise:
    """Noise of a synthetic camera; the defaults are those of a D415-like camera.

    Attributes:
        blur_sigma_px: Gaussian blur of the optics.
        read_sigma: grey levels, everywhere.
        shot_gain: variance of the shot noise in grey levels squared, per grey level.
        depth_sigma_at_1m_m: depth noise at 1 m; it grows with the square of the depth.
        depth_correlation_px: how far the depth noise hangs together (standard deviation of its
            kernel).
        depth_hole_rate: share of the pixels at steps in depth around which there is a hole, 0..1.
        min_depth_m, max_depth_m: nearer and farther there is no depth.
        depth_dark_lost, depth_gleam_lost: share of a black surface, and of paint that mirrors the
            sun into the camera, of which there is no depth (``hil.render.surfaces``).

    Raises:
        ValueError: naming the field that cannot be right.
    """

    blur_sigma_px: Annotated[float, Bounds(0.0, 20.0)] = 0.6
    read_sigma: Annotated[float, Bounds(0.0, 100.0, "grey levels")] = 1.2
    shot_gain: Annotated[float, Bounds(0.0, 1.0, "of 1")] = 0.015
    depth_sigma_at_1m_m: Annotated[float, Bounds(0.0, 1.0)] = 0.005
    depth_correlation_px: Annotated[float, Bounds(0.0, 50.0)] = 1.0
    depth_hole_rate: Annotated[float, Bounds(0.0, 1.0, "of 1")] = 0.25
    min_depth_m: Annotated[float, Bounds(0.0, 65.0)] = 0.3
    max_depth_m: Annotated[float, Bounds(0.05, 65.0)] = 6.0
    depth_dark_lost: Annotated[float, Bounds(0.0, 1.0, "of 1")] = 0.0
    depth_gleam_lost: Annotated[float, Bounds(0.0, 1.0, "of 1")] = 0.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not (math.isfinite(value) and value >= 0.0):
                raise ValueError(f"{field.name}: {value!r} is not a number >= 0")
        if self.depth_hole_rate > 1.0:
            raise ValueError(f"depth_hole_rate: {self.depth_hole_rate!r} is not a share, 0..1")
        if not self.min_depth_m < self.max_depth_m <= 65.0:
            raise ValueError(
                f"max_depth_m: {self.max_depth_m!r} is not above min_depth_m and at most 65 m"
            )
        if self.blur_sigma_px > 5.0:
            raise ValueError(f"blur_sigma_px: {self.blur_sigma_px!r} is more than 5 px")


NOISE_FREE = SensorNoise(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def blur_taps(sigma_px: float) -> Singles:
    """One side of a Gaussian kernel from its centre outwards, normalised as a whole; a single 1 for
    no blur.
    """
    if sigma_px < 0.1:
        return np.ones(1, np.float32)
    distance = np.arange(math.ceil(3.3 * sigma_px) + 1)
    taps = np.exp(-0.5 * (distance / sigma_px) ** 2)
    return (taps / (taps[0] + 2.0 * taps[1:].sum())).astype(np.float32)


def noise_pool(
    rng: np.random.Generator, height: int, width: int, correlation_px: float
) -> NDArray[np.int8]:
    """Unit Gaussian noise in steps of 1/POOL_UNIT, shape (height, width) plus the margin every
    frame moves in.
    """
    noise = rng.standard_normal((height + POOL_MARGIN, width + POOL_MARGIN), np.float32)
    if correlation_px >= 0.1:
        noise = cv2.GaussianBlur(noise, (0, 0), correlation_px)
        noise /= noise.std()
    return np.clip(np.round(noise * POOL_UNIT), -127, 127).astype(np.int8)


def mixed(*values: int) -> int:
    """A 64-bit hash of integers (the finaliser of splitmix64 per value): the same in every
    process.
    """
    state = 0
    for value in values:
        state = (state + value + 0x9E3779B97F4A7C15) & MASK
        state = ((state ^ (state >> 30)) * 0xBF58476D1CE4E5B9) & MASK
        state = ((state ^ (state >> 27)) * 0x94D049BB133111EB) & MASK
        state ^= state >> 31
    return state


@inner
def blur_row(plane, r, taps, down, padded, out):
    """One row of a plane, blurred both ways; the image's edge is repeated.

    taps, down: along rows and along columns. padded: float32 (w + 2 reach,), of ``taps``.
    """
    height, width = plane.shape
    reach = taps.size - 1
    middle = padded[reach : reach + width]
    row = plane[r]
    weight = down[0]
    for c in range(width):
        middle[c] = weight * F(row[c])
    for k in range(1, down.size):
        above = plane[max(r - k, 0)]
        below = plane[min(r + k, height - 1)]
        weight = down[k]
        for c in range(width):
            middle[c] += weight * (F(above[c]) + F(below[c]))
    padded[:reach] = middle[0]
    padded[reach + width :] = middle[width - 1]
    weight = taps[0]
    for c in range(width):
        out[c] = weight * middle[c]
    for k in range(1, taps.size):
        left = padded[reach - k : reach - k + width]
        right = padded[reach + k : reach + k + width]
        weight = taps[k]
        for c in range(width):
            out[c] += weight * (left[c] + right[c])


@kernel
def expose(image, taps, read_sigma, shot_gain, pool, offset_row, offset_column, rows, exposed):
    """Blur, noise and quantise the planes of ``image`` (3, h, w) into ``exposed``.

    rows: float32 scratch, at least 2 rows of w + 2 reach.
    """
    height, width = image.shape[1:]
    read2 = F(read_sigma * read_sigma / POOL_UNIT**2)
    gain = F(shot_gain / POOL_UNIT**2)
    padded = rows[0, : width + 2 * (taps.size - 1)]
    blurred = rows[1, :width]
    top = F(255.0)
    for k in range(3):
        first_row = (offset_row + k * CHANNEL_STEP) % POOL_MARGIN
        first_column = (offset_column + k * CHANNEL_STEP) % POOL_MARGIN
        for r in range(height):
            blur_row(image[k], r, taps, taps, padded, blurred)
            noise = pool[first_row + r, first_column : first_column + width]
            out = exposed[k, r]
            for c in range(width):
                level = blurred[c] + np.sqrt(read2 + gain * blurred[c]) * F(noise[c])
                out[c] = np.uint8(np.int32(min(max(level, F(0.0)), top) + F(0.5)))


@kernel
def measure_depth(
    inverse_z,
    owner,
    tags,
    hide_vehicles,
    sigma,
    near,
    far,
    off,
    pool,
    offset_row,
    offset_column,
    depth,
):
    """z in whole millimetres with noise that grows with z^2; 0 out of range, and over cars when
    they are hidden.

    sigma: standard deviation at 1 m in m; near, far in m. off: factor and mm by which what is
    measured is off then.
    """
    height, width = inverse_z.shape
    scale = F(sigma / 1000.0 / POOL_UNIT)  # of z^2 in mm^2
    near_mm = F(near * 1000.0)
    far_mm = F(far * 1000.0)
    thousand = F(1000.0)
    factor = F(off[0])
    bias = F(off[1] + 0.5)
    for r in range(height):
        w_row = inverse_z[r]
        out = depth[r]
        noise = pool[
            (offset_row % POOL_MARGIN) + r,
            offset_column % POOL_MARGIN : offset_column % POOL_MARGIN + width,
        ]
        for c in range(width):
            z = thousand / max(w_row[c], F(1e-3))
            z += scale * z * z * F(noise[c])
            inside = (z >= near_mm) & (z <= far_mm)
            whole = np.int32(z + F(0.5)) if inside else np.int32(0)
            out[c] = np.uint16(np.int32(factor * F(whole) + bias)) if whole > 0 else np.uint16(0)
        if hide_vehicles:
            for c in range(width):
                if owner[r, c] >= 0 and tags[owner[r, c], VEHICLE] == 1:
                    out[c] = 0


@inner
def _random(seed, index):
    """Uniform 0..1 from a seed and a position (splitmix64)."""
    state = np.uint64(seed) + np.uint64(index) * np.uint64(0x9E3779B97F4A7C15)
    state = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    state = (state ^ (state >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return float((state ^ (state >> np.uint64(31))) >> np.uint64(11)) / 9007199254740992.0


@kernel
def punch_holes(inverse_z, edges, rate, seed, depth):
    """No depth in 3 x 3 pixels around a random share of the pixels where the depth steps."""
    height, width = edges.shape
    for r in range(1, height - 1):
        for c in range(1, width - 1):
            if edges[r, c] == INTERIOR:
                continue
            low = inverse_z[r, c]
            high = inverse_z[r, c]
            for i in range(-1, 2):
                for j in range(-1, 2):
                    low = min(low, inverse_z[r + i, c + j])
                    high = max(high, inverse_z[r + i, c + j])
            if high - low > JUMP * high and _random(seed, r * width + c) < rate:
                depth[r - 1 : r + 2, c - 1 : c + 2] = 0


@kernel
def swallow(owner, lost, seed, depth):
    """No depth in patches of 3 x 3 pixels on that share of each face's; lost: float32, of each
    face.
    """
    height, width = owner.shape
    for r in range(height):
        for c in range(width):
            face = owner[r, c]
            if (
                face >= 0
                and lost[face] > F(0.0)
                and _random(seed, (r // 3) * width + c // 3) < lost[face]
            ):
                depth[r, c] = 0
