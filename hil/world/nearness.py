"""Distances between any number of bodies: no two are compared that are far apart."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FEW = 8


@dataclass(frozen=True, slots=True)
class Nearness:
    """
    Attributes:
        closest_m: between the two that are nearest to each other; infinite for fewer than two.
        pair: their names, as the others' in the order in which they were given.
        too_near: every pair that is nearer than was asked for.
    """

    closest_m: float
    pair: tuple[str, ...]
    too_near: tuple[tuple[str, str, float], ...]


def nearness(names: tuple[str, ...], places_m: NDArray[np.float64], within_m: float) -> Nearness:
    """Of bodies at places, (n, 3) in m. A pair is too near when it is nearer than ``within_m``."""
    places = [tuple(place) for place in places_m.tolist()]
    if len(names) <= FEW:
        pairs = [(j, i) for i in range(len(names)) for j in range(i)]
    else:
        from scipy.spatial import KDTree  # noqa: PLC0415 (a few are compared without)

        tree = KDTree(places_m)
        to_next, _ = tree.query(places_m, k=2)
        reach_m = max(float(to_next[:, 1].min()), within_m) + 1e-9
        pairs = sorted(tree.query_pairs(reach_m))
    closest_m, closest = math.inf, ()
    too_near: list[tuple[str, str, float]] = []
    for j, i in pairs:
        apart_m = math.dist(places[j], places[i])
        if apart_m < closest_m:
            closest_m, closest = apart_m, (names[j], names[i])
        if apart_m < within_m:
            too_near.append((names[j], names[i], apart_m))
    return Nearness(closest_m, closest, tuple(too_near))
