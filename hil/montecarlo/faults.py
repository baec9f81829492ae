"""The faults of a Monte-Carlo hand-over now and then: when, how much, for whom."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from flight.harness.montecarlo import FaultName
from path.arrays import Array
from path.values import frozen

Generator = np.random.Generator

LINK_DELAY_S = 0.004
LINK_JITTER_S = 0.002
LINK_LOSS = 0.01
MIXABLE: tuple[FaultName, ...] = (
    "marker_occlusion", "marker_dropouts", "flip", "depth_holes", "link_loss", "link_delay", "clock_error",
    "camera_freeze", "attitude_jump", "look_alike_near", "look_alike_crossing", "detector_swap",
)  # fmt: skip


@frozen
class HandoverFaults:
    """The faults of one hand-over: rows (from, to) in s, and how much."""

    hidden: Array
    flipped: Array
    holes: Array
    swapped: Array
    frozen: tuple[Array, Array]
    jump: tuple[Array, Array]  # attitude of each drone
    jump_vector: Array  # (3,) rad
    lapse_rate: float
    loss: float
    delay_s: float
    jitter_s: float
    clock_s: float


NEVER = np.empty((0, 2))
NO_FAULTS = HandoverFaults(
    NEVER, NEVER, NEVER, NEVER, (NEVER, NEVER), (NEVER, NEVER), np.zeros(3), 0.0, LINK_LOSS, LINK_DELAY_S,
    LINK_JITTER_S, 0.0,
)  # fmt: skip


def draw_faults(fault: FaultName, rng: Generator) -> tuple[tuple[FaultName, ...], HandoverFaults]:
    """The faults by name, two different ones for "mixed", and all of them together."""
    names: tuple[FaultName, ...] = (fault,)
    if fault == "mixed":
        first, second = rng.choice(len(MIXABLE), 2, replace=False).tolist()
        names = MIXABLE[first], MIXABLE[second]
    faults = NO_FAULTS
    for name in names:
        faults = _with_fault(faults, name, rng)
    return names, faults


def direction(rng: Generator) -> Array:
    angle = rng.uniform(-math.pi, math.pi)
    return np.array([math.cos(angle), math.sin(angle)])


def _spells(
    rng: Generator,
    most: int,
    low_s: float,
    high_s: float,
) -> Array:
    """One to ``most`` spells within the first five seconds, lengths spread evenly over their
    logarithm.
    """
    count = int(rng.integers(1, most + 1))
    start = rng.uniform(0.0, 5.0, count)
    length = np.exp(rng.uniform(math.log(low_s), math.log(high_s), count))
    return np.stack((start, start + length), axis=1)


def _with_fault(
    faults: HandoverFaults,
    name: FaultName,
    rng: Generator,
) -> HandoverFaults:
    match name:
        case "marker_occlusion":
            faults = replace(faults, hidden=_spells(rng, 2, 0.1, 3.0))
        case "marker_dropouts":
            faults = replace(faults, lapse_rate=rng.uniform(0.005, 0.10))
        case "flip":
            faults = replace(faults, flipped=_spells(rng, 3, 0.02, 1.5))
        case "depth_holes":
            faults = replace(faults, holes=_spells(rng, 3, 0.1, 1.5))
        case "link_loss":
            faults = replace(faults, loss=rng.uniform(0.02, 0.5))
        case "link_delay":
            delay_s = rng.uniform(0.01, 0.12)
            faults = replace(faults, delay_s=delay_s, jitter_s=delay_s)
        case "clock_error":
            faults = replace(
                faults, clock_s=float(rng.choice((-1.0, 1.0))) * rng.uniform(0.005, 0.06)
            )
        case "camera_freeze":
            faults = replace(faults, frozen=_of_one(_spells(rng, 3, 0.1, 1.5), rng))
        case "attitude_jump":
            spells = _spells(rng, 2, 0.3, 4.0)
            angle = math.radians(rng.uniform(2.0, 12.0))
            vector = angle * np.array([*direction(rng), 0.0])
            faults = replace(faults, jump=_of_one(spells, rng), jump_vector=vector)
        case "detector_swap":
            faults = replace(faults, swapped=_spells(rng, 1, 0.3, 8.0))
        case _:
            pass
    return faults


def _of_one(spells: Array, rng: Generator) -> tuple[Array, Array]:
    """Return spells of one drone or the other."""
    return (spells, NEVER) if rng.random() < 0.5 else (NEVER, spells)
