"""The air that a hovering drone throws down, and what it does to a drone below. Pure.

All propellers together make one round turbulent jet (Bauersfeld et al., arXiv 2403.13321). With the
mass m, n propellers of radius r, the distance l between opposite motors, s below the rotors and r
beside the axis, density rho:

    U_H = sqrt(m g / (2 rho n pi r^2))                        eq. 1, momentum theory
    U_c = U_H B / (s / l - s0)                                eq. 2, on the axis: it decays
    U   = U_c / (1 + (sqrt(2) - 1) (r / h)^2)^2               eq. 3, shear across it
    h   = S l (s / l - s0)                                    eq. 6, its half width: it spreads

B, S and s0 are that paper's fit (eq. 9), of drones from 30 g to 2 kg, from 2.5 l below the rotors on.
Nearer it is rough: there the jets of single propellers have not merged yet. The fit's tail falls with
the fourth power only; in measured jets less than 2 % is left at EDGE, to which it is faded out.

Two things push a drone with rotors of its own U_H in air that comes down on it with U:

- less lift. At the same power a rotor in an inflow u = U / U_H has w^2 (w - u) = 1 and the thrust
  T / T0 = 1 / w, which is 1 - u / 3 for what is small (momentum theory). Su et al. (arXiv 2207.09645)
  measured 0.05 to 0.07 s/m of a Crazyflie, where this says 0.08.
- drag of its body: rho C A U^2 / (2 m).
"""

from __future__ import annotations

import math

from drivers.rig.facts import DroneFacts
from flight.guidance import GRAVITY_MPS2
from path.compiled import as_it_is
from path.values import frozen

AIR_KGPM3 = 1.225
DECAY = 10.11
SPREAD = 0.07668
ORIGIN = -5.817  # of the jet, in l: above the rotors
EDGE = 2.5  # half widths
HALF_WIDTH = math.sqrt(2.0) - 1.0
# Of a drone's circle over the tips: what its body, arms and blades fill. Their drag coefficient is 1.
SOLID = 0.15
# A circle of one propeller, of that over all tips: 0.34 (X500) to 0.38 (Tello).
PROPELLER_SHARE = 0.36
# kg of a drone whose circle is 1 m wide, and how it grows with that: between Crazyflie (0.14 m,
# 0.03 kg), Tello (0.2 m, 0.08 kg) and X500 with a depth camera (0.75 m, 2 kg).
MASS_KG = 4.0
MASS_POWER = 2.4


@frozen
class Rotors:
    """What a drone's air follows from.

    Attributes:
        size_m: l, between opposite motors.
        hover_mps: U_H.
        drag_per_m: rho C A / (2 m): times the square of a speed it is an acceleration.
    """

    size_m: float
    hover_mps: float
    drag_per_m: float


def rotors_of(drone: DroneFacts) -> Rotors:
    """Return those of a drone, with what drones of its diameter usually have where it says none."""
    wide_m = drone.diameter_m
    mass_kg = MASS_KG * wide_m**MASS_POWER if drone.mass_kg is None else drone.mass_kg
    propeller_m = PROPELLER_SHARE * wide_m if drone.propeller_m is None else drone.propeller_m
    disc_m2 = drone.propellers * math.pi * (0.5 * propeller_m) ** 2
    solid_m2 = SOLID * math.pi * (0.5 * wide_m) ** 2
    return Rotors(
        wide_m - propeller_m,
        math.sqrt(mass_kg * GRAVITY_MPS2 / (2.0 * AIR_KGPM3 * disc_m2)),
        0.5 * AIR_KGPM3 * solid_m2 / mass_kg,
    )


@as_it_is
def jet_mps(below_m: float, beside_m: float, size_m: float, hover_mps: float) -> float:
    """Return the mean speed of the air below a drone, along the jet (eq. 2, 3 and 6); 0 above it
    and beyond its edge.
    """
    if below_m <= 0.0:
        return 0.0
    far = below_m / size_m - ORIGIN
    across = beside_m / (SPREAD * size_m * far)
    if across >= EDGE:
        return 0.0
    shear = 1.0 + HALF_WIDTH * across * across
    fades = 1.0 - (across / EDGE) ** 4
    return fades * hover_mps * DECAY / (far * shear * shear)


@as_it_is
def lift_share(inflow_mps: float, hover_mps: float) -> float:
    """Return the share of its lift that a rotor keeps in air that comes down on it."""
    u = inflow_mps / hover_mps
    w = 1.0 + u
    for _ in range(4):  # Newton's, from above: it converges at once
        w -= (w * w * (w - u) - 1.0) / (w * (3.0 * w - 2.0 * u))
    return 1.0 / w


@as_it_is
def sinks_s(below_m: float, size_m: float, hover_mps: float) -> float:
    """Return how long the air on the axis takes to come down so far: the integral of 1 / U_c. So
    long a wind carries it aside.
    """
    far = below_m / size_m
    return size_m * far * (0.5 * far - ORIGIN) / (DECAY * hover_mps)


def push_mps2(rotors: Rotors, below_m: float, beside_m: float) -> float:
    """Return by how much the air of a drone pushes an equal one down that hovers so far below and
    beside it: the mean of four rotors, one arm towards the jet.
    """
    arm_m = 0.5 * rotors.size_m
    total_mps2 = 0.0
    for along_m, across_m in ((arm_m, 0.0), (-arm_m, 0.0), (0.0, arm_m), (0.0, -arm_m)):
        apart_m = math.hypot(beside_m + along_m, across_m)
        air_mps = jet_mps(below_m, apart_m, rotors.size_m, rotors.hover_mps)
        lost = 1.0 - lift_share(air_mps, rotors.hover_mps)
        total_mps2 += GRAVITY_MPS2 * lost + rotors.drag_per_m * air_mps * air_mps
    return 0.25 * total_mps2


def keep_out_m(rotors: Rotors, below_m: float, held_mps2: float) -> float:
    """Return how far beside a drone an equal one must be, so far below it, to be pushed by no more
    than it holds.
    """
    inside_m = 0.0
    outside_m = rotors.size_m + EDGE * SPREAD * (below_m - ORIGIN * rotors.size_m)
    if push_mps2(rotors, below_m, inside_m) <= held_mps2:
        return 0.0
    for _ in range(20):
        middle_m = 0.5 * (inside_m + outside_m)
        if push_mps2(rotors, below_m, middle_m) > held_mps2:
            inside_m = middle_m
        else:
            outside_m = middle_m
    return outside_m
