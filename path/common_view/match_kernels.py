"""Loose matches of binary descriptors, and what they say of a translation, compiled."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from path.arrays import Array, Whole
from path.compiled import inner, kernel

Bits = NDArray[np.uint8]
Words = NDArray[np.uint64]
Counts = NDArray[np.float32]


@inner
def _ones(x: np.uint64) -> int:
    """Count the ones of a word."""
    x = x - ((x >> np.uint64(1)) & np.uint64(0x5555555555555555))
    x = (x & np.uint64(0x3333333333333333)) + ((x >> np.uint64(2)) & np.uint64(0x3333333333333333))
    x = (x + (x >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return int((x * np.uint64(0x0101010101010101)) >> np.uint64(56))


@kernel
def distances(first: Words, second: Words) -> NDArray[np.int16]:
    """Return the Hamming distances (n, m) of descriptors (n, 4) and (m, 4) of 64-bit words."""
    out = np.empty((first.shape[0], second.shape[0]), np.int16)
    for i in range(first.shape[0]):
        a = first[i, 0]
        b = first[i, 1]
        c = first[i, 2]
        d = first[i, 3]
        for j in range(second.shape[0]):
            out[i, j] = (
                _ones(a ^ second[j, 0])
                + _ones(b ^ second[j, 1])
                + _ones(c ^ second[j, 2])
                + _ones(d ^ second[j, 3])
            )
    return out


@kernel
def nearest(hamming: NDArray[np.int16], each: int, out: Whole) -> None:
    """Write the columns of the ``each`` smallest of every row into ``out`` (n, each)."""
    n, m = hamming.shape
    for i in range(n):
        held = 0
        for j in range(m):
            value = hamming[i, j]
            if held == each and value >= hamming[i, out[i, held - 1]]:
                continue
            k = held if held < each else each - 1
            held = min(held + 1, each)
            while k > 0 and hamming[i, out[i, k - 1]] > value:
                out[i, k] = out[i, k - 1]
                k -= 1
            out[i, k] = j


@kernel
def votes(
    first: Array, second: Array, weights: Array, yaws: Array, low: Array, cell: float, out: Counts
) -> None:  # fmt: skip
    """Let every match vote for the translation that it says, at each yaw.

    Args:
        first, second: (n, 3) matched points in both levelled frames.
        weights: (n,). ``low``: (3,) the corner of the box.
        out: (yaws, x, y, z) of zeros.
    """
    size = out.shape
    for a in range(len(yaws)):
        c = math.cos(yaws[a])
        s = math.sin(yaws[a])
        for k in range(len(weights)):
            x = first[k, 0] - c * second[k, 0] + s * second[k, 1] - low[0]
            y = first[k, 1] - s * second[k, 0] - c * second[k, 1] - low[1]
            z = first[k, 2] - second[k, 2] - low[2]
            i = math.floor(x / cell)
            j = math.floor(y / cell)
            m = math.floor(z / cell)
            if 0 <= i < size[1] and 0 <= j < size[2] and 0 <= m < size[3]:
                out[a, i, j, m] += weights[k]


@kernel
def spread(votes: Counts, out: Counts) -> None:
    """Write the sum of each cell's 3 x 3 x 3 neighbours into ``out``: one axis after the other."""
    _, X, Y, Z = votes.shape
    line = np.empty((X, Y, Z), np.float32)
    plane = np.empty((X, Y, Z), np.float32)
    for a in range(len(votes)):
        for i in range(X):
            for j in range(Y):
                for k in range(Z):
                    before = votes[a, i, j, k - 1] if k > 0 else 0.0
                    after = votes[a, i, j, k + 1] if k < Z - 1 else 0.0
                    line[i, j, k] = before + votes[a, i, j, k] + after
        for i in range(X):
            for j in range(Y):
                for k in range(Z):
                    before = line[i, j - 1, k] if j > 0 else 0.0
                    after = line[i, j + 1, k] if j < Y - 1 else 0.0
                    plane[i, j, k] = before + line[i, j, k] + after
        for i in range(X):
            for j in range(Y):
                for k in range(Z):
                    before = plane[i - 1, j, k] if i > 0 else 0.0
                    after = plane[i + 1, j, k] if i < X - 1 else 0.0
                    out[a, i, j, k] = before + plane[i, j, k] + after


@kernel
def peaks(votes: Counts, least: float, out: Whole, sizes: Array) -> int:
    """Write the highest cells that no neighbour exceeds into ``out`` (n, 4) and their votes into
    ``sizes`` (n,), highest first; return how many.

    Args:
        least: votes of a cell that is worth a look.
    """
    n, X, Y, Z = votes.shape
    held = 0
    most = len(sizes)
    for a in range(n):
        for i in range(X):
            for j in range(Y):
                for k in range(Z):
                    value = votes[a, i, j, k]
                    if value < least or (held == most and value <= sizes[held - 1]):
                        continue
                    if _exceeded(votes, a, i, j, k):
                        continue
                    place = held if held < most else most - 1
                    held = min(held + 1, most)
                    while place > 0 and sizes[place - 1] < value:
                        sizes[place] = sizes[place - 1]
                        out[place] = out[place - 1]
                        place -= 1
                    sizes[place] = value
                    out[place, 0], out[place, 1] = a, i
                    out[place, 2], out[place, 3] = j, k
    return held


@inner
def _exceeded(votes: Counts, a: int, i: int, j: int, k: int) -> bool:
    """Return whether a neighbour has more votes, or as many and comes first."""
    n, X, Y, Z = votes.shape
    value = votes[a, i, j, k]
    for b in range(max(a - 1, 0), min(a + 2, n)):
        for x in range(max(i - 1, 0), min(i + 2, X)):
            for y in range(max(j - 1, 0), min(j + 2, Y)):
                for z in range(max(k - 1, 0), min(k + 2, Z)):
                    other = votes[b, x, y, z]
                    if other > value:
                        return True
                    if other == value and (b, x, y, z) < (a, i, j, k):
                        return True
    return False
