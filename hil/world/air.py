"""The air that flying drones throw down, and how it pushes whoever is in it: drones, and what flies
as a target.

The mean is the jet of ``flight.wash``. The world adds what a plan cannot know: it is thrown along
the drone's own axis with the thrust of the moment, carried aside by the wind (and left behind by a
drone that moves) for as long as it sinks, and it is turbulent. Turbulence is noise by seed that
wanders within EDDY_S, TURBULENCE of the mean (measured on the axis of round jets: 0.25 to 0.28).

Two things are rough. Within a half width of the ground the jet turns outward, and is twice as
turbulent. Air that walls send back is ``recirculated``: a share of every drone's own U_H about
itself, wherever it flies; 0 in the open. A jet's pull at the air above and beside it, the moment of
a lift that is lost on one side, and the air of targets are left out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import field
from typing import Annotated

import numpy as np

from drivers.rig.facts import DroneFacts
from flight.wash import ORIGIN, SPREAD, Rotors, jet_mps, lift_share, rotors_of, sinks_s
from hil.world.dynamics import (
    ATTITUDE,
    CONTACT,
    GRAVITY_MPS2,
    IDLE_THRUST,
    POSITION,
    STATE_SIZE,
    THRUST,
)
from path.arrays import Array
from path.bounds import Bounds
from path.compiled import inner, kernel
from path.messages import Vec3
from path.values import frozen

EDDY_S = 0.1
TURBULENCE = 0.25
BLOCK = 256  # ticks of random numbers drawn at once
FARTHEST_M = 10.0  # beside a drone: nothing of its air comes so far
ARMS_N = (1.0, -1.0, 0.0, 0.0)
ARMS_E = (0.0, 0.0, 1.0, -1.0)
MICRO = DroneFacts(diameter_m=0.31)
"""A micro-UAV that is tracked."""
HOLDS_HZ = 3.0  # the natural frequency, rad/s, with which it comes back to its way, without a swing


@frozen
class AirConfig:
    """The ``[world.air]`` table of a rig.

    Attributes:
        wash: times the speed that a drone's air has by its mass and propellers; 0: none.
        recirculated: share of that speed that comes back from walls.
        drone: of what mass and size the drones are; as ``[drone]`` says, if nothing else is said.
    """

    wash: Annotated[float, Bounds(0.0, 5.0, "times")] = 1.0
    recirculated: Annotated[float, Bounds(0.0, 1.0, "of 1")] = 0.0
    drone: DroneFacts = field(default_factory=DroneFacts)


Own = tuple[float, float, float]


@inner
def _blow(
    a: Array, upper: Array, winds: Array, noise: Array, size_m: float, hover_mps: float, arm_m: float, air: Array
) -> None:  # fmt: skip
    """Add the air of all upper drones to what comes down on the four rotors of one, (4, 3)."""
    for j in range(upper.shape[0]):
        b = upper[j]
        below = a[2] - b[2]
        beside_n = a[0] - b[0]
        beside_e = a[1] - b[1]
        far = beside_n * beside_n + beside_e * beside_e > FARTHEST_M * FARTHEST_M
        w = b[6]
        x = b[7]
        y = b[8]
        z = b[9]
        axis_d = 1.0 - 2.0 * (x * x + y * y)
        if below <= 0.0 or far or b[THRUST] <= IDLE_THRUST or axis_d < 0.5:
            continue
        axis_n = 2.0 * (x * z + w * y)
        axis_e = 2.0 * (y * z - w * x)
        hover = hover_mps * math.sqrt(b[THRUST] / GRAVITY_MPS2)
        late_s = sinks_s(below, size_m, hover)
        beside_n -= below * axis_n / axis_d + late_s * (winds[j, 0] - b[3])
        beside_e -= below * axis_e / axis_d + late_s * (winds[j, 1] - b[4])
        half_width = SPREAD * (below - ORIGIN * size_m)
        straight = min(1.0, max(0.0, -a[2] / half_width))
        rough = TURBULENCE * (2.0 - straight)
        for k in range(4):
            n = beside_n + arm_m * ARMS_N[k]
            e = beside_e + arm_m * ARMS_E[k]
            apart = math.hypot(n, e)
            mps = jet_mps(below, apart, size_m, hover)
            outward = (1.0 - straight) / max(apart, 0.01)
            air[k, 0] += mps * (axis_n * straight + n * outward + rough * noise[0])
            air[k, 1] += mps * (axis_e * straight + e * outward + rough * noise[1])
            air[k, 2] += mps * (axis_d * straight + rough * noise[2])


@kernel
def pushes(
    lower: Array, upper: Array, winds: Array, noise: Array, size_m: float, hover_mps: float,
    own: Own, sideways_hz: float, own_share: float, out: Array,
) -> None:  # fmt: skip
    """Write by how much the air of all upper drones pushes each lower one.

    Args:
        lower, upper: state rows of ``hil.world.dynamics``; a drone is not below itself.
        winds: (n, 3) at the upper ones, NED m/s.
        noise: (m, 3) of variance 1, at the lower ones.
        size_m, hover_mps: of the upper ones.
        own: ``size_m``, ``hover_mps`` and ``drag_per_m`` of the lower ones.
        sideways_hz: their rotors' drag across.
        own_share: of their own U_H that comes back to them.
        out: (m, 3) NED m/s^2, written; 0 for what stands: its legs hold.
    """
    air = np.zeros((4, 3))  # that comes down on each rotor, NED m/s
    for i in range(lower.shape[0]):
        a = lower[i]
        out[i, :] = 0.0
        if a[CONTACT] > 0.0 or a[THRUST] <= IDLE_THRUST:
            continue
        air[:] = own_share * own[1] * noise[i]
        _blow(a, upper, winds, noise[i], size_m, hover_mps, 0.5 * own[0], air)
        w = a[6]
        x = a[7]
        y = a[8]
        z = a[9]
        for k in range(4):
            inflow = max(-0.5 * own[1], air[k, 2])
            lost = 0.25 * a[THRUST] * (1.0 - lift_share(inflow, own[1]))
            speed = math.sqrt(air[k, 0] ** 2 + air[k, 1] ** 2 + air[k, 2] ** 2)
            drag = 0.25 * own[2] * speed
            across = drag + 0.25 * sideways_hz
            out[i, 0] += lost * 2.0 * (x * z + w * y) + across * air[k, 0]
            out[i, 1] += lost * 2.0 * (y * z - w * x) + across * air[k, 1]
            out[i, 2] += lost * (1.0 - 2.0 * (x * x + y * y)) + drag * air[k, 2]


class Air:
    """The air of one world, advanced tick by tick.

    Attributes:
        wash: times the speed of the jets, which a fault may make stronger.
        pushes: (drones, 3) NED m/s^2.
        shifts_w_m: (targets, 3), how far each target that flies is off its way.
    """

    def __init__(
        self, config: AirConfig, sideways_hz: float, drones: int, targets: int, seed: int, tick_s: float
    ) -> None:  # fmt: skip
        self.wash = config.wash
        self._share = config.recirculated
        self._sideways_hz = sideways_hz
        self._drone = rotors_of(config.drone)
        self._target = rotors_of(MICRO)
        self._rng = np.random.default_rng([seed, 0x616972])
        self._decay = math.exp(-tick_s / EDDY_S)
        self._drive = math.sqrt(1.0 - self._decay**2)
        self._noise = self._rng.standard_normal((drones + targets, 3))
        self._normals = np.empty((BLOCK, *self._noise.shape))
        self._used = BLOCK
        self.pushes = np.zeros((drones, 3))
        self.shifts_w_m = np.zeros((targets, 3))
        self._speeds_w_mps = np.zeros((targets, 3))

    def tick(self, states: Array, winds: Array) -> None:
        """Work out what pushes each drone until the next tick."""
        if self.wash <= 0.0 and self._share <= 0.0:
            return
        if self._used == BLOCK:
            self._normals[:] = self._rng.standard_normal(self._normals.shape)
            self._used = 0
        self._noise = self._decay * self._noise + self._drive * self._normals[self._used]
        self._used += 1
        noise = self._noise[: len(states)]
        self._push(states, states, winds, noise, self._drone, self._share, self.pushes)

    def move_targets(
        self, places_w_m: Sequence[Vec3], states: Array, winds: Array, by_s: float
    ) -> None:
        """Push what flies as a target off its way for a moment; it comes back by itself.

        Args:
            places_w_m: of each target on its way.
        """
        rows = np.zeros((len(places_w_m), STATE_SIZE))
        rows[:, POSITION] = [(y, x, -z) for x, y, z in np.array(places_w_m) + self.shifts_w_m]
        rows[:, ATTITUDE.start] = 1.0
        rows[:, THRUST] = GRAVITY_MPS2
        pushed = np.zeros((len(rows), 3))
        noise = self._noise[len(states) :]
        self._push(rows, states, winds, noise, self._target, 0.0, pushed)
        push_w_mps2 = pushed[:, (1, 0, 2)] * (1.0, 1.0, -1.0)
        back_mps2 = HOLDS_HZ * (HOLDS_HZ * self.shifts_w_m + 2.0 * self._speeds_w_mps)
        self._speeds_w_mps += by_s * (push_w_mps2 - back_mps2)
        self.shifts_w_m += by_s * self._speeds_w_mps

    def _push(
        self, lower: Array, upper: Array, winds: Array, noise: Array, own: Rotors, share: float, out: Array
    ) -> None:  # fmt: skip
        thrown = self._drone
        pushes(
            lower, upper, winds, noise, thrown.size_m, self.wash * thrown.hover_mps,
            (own.size_m, own.hover_mps, own.drag_per_m), self._sideways_hz, share, out,
        )  # fmt: skip
