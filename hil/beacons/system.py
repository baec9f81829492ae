"""An ultrasonic positioning system in a simulated world: beacons on both drones and on the target,
and what they send.

What a system of this kind gets wrong (``hil.beacons.noise``) is put onto the truth. The bytes are
Marvelmind's; who listens parses them as it would the real ones.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from drivers.beacons.log import BeaconTruth, Mounted
from drivers.log.mcap_log import read_log
from hil.beacons import marvelmind_bytes as sent
from hil.beacons.noise import BeaconConfig, Warp
from path.arrays import Array
from path.geometry.rotation import R_from_quat, R_from_rpy, normalized
from path.messages import Vec3
from path.values import frozen

EPOCH_S = 3600.0  # of all clocks: they have been on for a while
PORT = "modem"
# in the system's frame
STATIONARY_M: dict[int, Vec3] = {k: (4.0 * (k % 2), 4.0 * (k // 2), 2.0) for k in range(1, 5)}


class BeaconFrame(NamedTuple):
    """The system's frame: a point of the world, ``p``, is ``Rz(yaw) p + origin`` in it."""

    yaw_rad: float
    origin_m: Array  # (3,)


@frozen
class ByteChunk:
    """Bytes that reach the listener together, at an instant of the world."""

    arrives_s: float
    data: bytes


@dataclass(slots=True)
class _Beacon:
    """One mobile beacon: what it is in the middle of."""

    silent_until_s: float = -math.inf
    # to come, with their quality
    wrong: list[tuple[Vec3, float]] = field(default_factory=list[tuple[Vec3, float]])


class BeaconSystem:
    """Beacons by name, as they take turns. One seed gives one history for the same places.

    Attributes:
        frame: (R, origin): a point of the world is ``R p + origin`` in the system's frame.
        listener_offset_s: the listener's clock minus the world's, at the world's ``drift_from_s``.
    """

    def __init__(
        self,
        config: BeaconConfig,
        seed: int,
        addresses: Mapping[str, int],
        drift_from_s: float = 0.0,
        surveyed: BeaconFrame | None = None,
    ) -> None:
        """``surveyed``: the frame, where it was laid out with care; drawn by seed when None."""
        self._config, self._rng = config, np.random.default_rng([seed, 0xBEAC])
        # positions are the same with and without them
        self._distances_rng = np.random.default_rng([seed, 0xBEAC, 1])
        self._addresses = dict(addresses)
        rng = self._rng
        self._clock_s, self.listener_offset_s = (
            EPOCH_S + rng.uniform(-1.0, 1.0, 2) * config.clock_offset_s
        )
        self._drift, self._listener_drift = 1e-6 * config.drift_ppm * rng.uniform(-1.0, 1.0, 2)
        self._drift_from_s = drift_from_s
        drawn = BeaconFrame(float(rng.uniform(-math.pi, math.pi)), rng.uniform(-10.0, 10.0, 3))
        self.yaw_rad, self.origin_m = surveyed or drawn
        self._R = R_from_rpy(0.0, 0.0, self.yaw_rad)
        self._warp = Warp(config, rng)
        self._beacons = {name: _Beacon() for name in addresses}
        self._line_free_s = -math.inf
        self._turns = 0

    def turns(self, begin_s: float) -> Iterator[tuple[float, str]]:
        """Instants of ultrasound and whose, without end."""
        names = list(self._addresses)
        step_s = 1.0 / (self._config.rate_hz * len(names))
        turn = 0
        while True:
            yield begin_s + turn * step_s, names[turn % len(names)]
            turn += 1

    def listener_s(self, world_s: float) -> float:
        """The listener's clock at an instant of the world."""
        return (
            world_s + self.listener_offset_s + self._listener_drift * (world_s - self._drift_from_s)
        )

    def hear(
        self,
        name: str,
        time_s: float,
        place_w: Array,
    ) -> ByteChunk:
        """One turn of one beacon: what the line brings because of it, perhaps nothing of use.

        Args:
            time_s: instant of the ultrasound, by the world.
            place_w: (3,) where the beacon truly is.
        """
        config = self._config
        rng = self._rng
        latency_s = max(0.0, config.latency_s + config.jitter_s * rng.standard_normal())
        data = b"".join(self._frames(name, time_s, place_w, latency_s))
        late_s = rng.uniform(0.0, config.late_s) if rng.random() < config.late_rate else 0.0
        way_s = config.wire_s + rng.exponential(config.wire_jitter_s) + late_s
        # bytes do not overtake each other
        self._line_free_s = max(self._line_free_s, time_s + latency_s + way_s)
        return ByteChunk(self._line_free_s, data)

    def _frames(
        self,
        name: str,
        time_s: float,
        place_w: Array,
        latency_s: float,
    ) -> Iterator[bytes]:
        address = self._addresses[name]
        shown_s = time_s + self._clock_s + self._drift * (time_s - self._drift_from_s)
        stamp_ms = math.floor(
            1e3 * (shown_s + self._config.stamp_jitter_s * self._rng.standard_normal())
        )
        # of the stamp: what the system itself can know
        age_ms = math.floor(1e3 * (shown_s + latency_s)) - stamp_ms
        self._turns += 1
        shown = self._shown(self._beacons[name], time_s, place_w)
        rng = self._rng
        if shown is not None:
            place, quality = shown
            yield self._damaged(sent.quality(address, round(quality)), rng)
            yield self._damaged(sent.position(stamp_ms, address, place, max(1, age_ms)), rng)
            ranges_m = {
                beacon: math.dist(place, stands_m) for beacon, stands_m in STATIONARY_M.items()
            }
            yield self._damaged(sent.distances(stamp_ms, address, ranges_m), self._distances_rng)
        yield self._damaged(sent.imu(stamp_ms, rng.bytes(18)), rng)
        if self._turns % 24 == 1:
            yield self._damaged(sent.telemetry(3.9, -60), rng)
            yield self._damaged(sent.stationary(STATIONARY_M), rng)

    def _shown(
        self,
        beacon: _Beacon,
        time_s: float,
        place_w: Array,
    ) -> tuple[Vec3, float] | None:
        """The position as the system has it, and its quality; None when it has none."""
        config = self._config
        rng = self._rng
        if rng.random() < config.gap_rate / config.rate_hz:
            beacon.silent_until_s = time_s + config.gap_s
        if rng.random() < config.reflection_rate and not beacon.wrong:
            off_m = tuple((config.reflection_m * rng.standard_normal(3)).tolist())
            quality = rng.uniform(20.0, 70.0) if rng.random() < 2.0 / 3.0 else math.nan
            beacon.wrong = [(off_m, quality)] * int(rng.integers(1, 4))
        noise_m = rng.normal(0.0, config.noise_m, 3)
        quality = float(np.clip(rng.normal(92.0, 4.0), 0.0, 100.0))
        off_m, poor = beacon.wrong.pop() if beacon.wrong else ((0.0, 0.0, 0.0), math.nan)
        if rng.random() < config.drop_rate or time_s < beacon.silent_until_s:
            return None
        place = place_w + self._warp.at(place_w[None])[0] + noise_m + off_m
        x, y, z = (self._R @ place + self.origin_m).tolist()
        return (x, y, z), quality if math.isnan(poor) else poor

    def _damaged(self, frame: bytes, rng: np.random.Generator) -> bytes:
        what = int(rng.random() / self._config.damage_rate) if self._config.damage_rate > 0.0 else 3
        if what == 0:
            return frame[: int(rng.integers(1, len(frame)))]
        if what == 1:
            bit = int(rng.integers(0, 8 * len(frame)))
            return (int.from_bytes(frame, "little") ^ (1 << bit)).to_bytes(len(frame), "little")
        if what == 2:
            return rng.bytes(int(rng.integers(1, 40))) + frame
        return frame


def listen(
    world_log: Path,
    hear: Callable[[str, int, bytes], object],
    seed: int,
    mounted: Mapping[str, Mounted],
) -> BeaconTruth:
    """Let somebody with a computer of his own hear what the beacons would have sent during a run.

    Args:
        hear: called with (port, arrival_ns, bytes), by the listener's clock, in order.
        mounted: by body: "sender", "receiver" (lever in the body, FRD) or "target" (in the frame of
            an object).

    Returns:
        What is true of the beacons.

    Raises:
        ValueError: the log holds no truth.
        OSError: it cannot be read.
    """
    config = BeaconConfig()
    stamps_s, paths = _paths(world_log, mounted)
    addresses = {name: own.address for name, own in mounted.items()}
    system = BeaconSystem(config, seed, addresses, 0.5 * float(stamps_s[0] + stamps_s[-1]))
    for time_s, name in system.turns(float(stamps_s[0])):
        if time_s > stamps_s[-1]:
            break
        place_w = np.array([np.interp(time_s, stamps_s, paths[name][:, k]) for k in range(3)])
        chunk = system.hear(name, time_s, place_w)
        if chunk.data:
            hear(PORT, round(1e9 * system.listener_s(chunk.arrives_s)), chunk.data)
    return truth_of(system, config)


def truth_of(system: BeaconSystem, config: BeaconConfig) -> BeaconTruth:
    """Return the truth that a trial may be judged by."""
    x, y, z = system.origin_m.tolist()
    return BeaconTruth(-float(system.listener_offset_s), system.yaw_rad, (x, y, z), config.table)


def _paths(world_log: Path, mounted: Mapping[str, Mounted]) -> tuple[Array, dict[str, Array]]:
    """Instants (n,) of the world's clock in s, and where each beacon truly was (n, 3), in ``w``."""
    target_id = 0
    rows = list[tuple[float, dict[str, Any]]]()
    for record in read_log(world_log):
        if record.topic == "/scene":
            target_id = record.record["target_id"]
        elif record.topic == "/truth":
            rows.append((record.stamp_ns * 1e-9, record.record))
    if len(rows) < 2:
        raise ValueError(f"{world_log} holds no truth")
    paths = {
        name: np.array([_place(name, row, target_id, own.lever_m) for _, row in rows])
        for name, own in mounted.items()
    }
    return np.array([time_s for time_s, _ in rows]), paths


def _place(
    name: str,
    row: dict[str, Any],
    target_id: int,
    lever_m: Vec3,
) -> Array:
    if name == "target":
        target = next(found for found in row["objects"] if found["id"] == target_id)
        (x, y, z), yaw = target["t"], target["yaw"]
        return np.array([x, y, z]) + R_from_rpy(0.0, 0.0, yaw) @ lever_m
    w, x, y, z = row[name]["q"]
    return np.array(row[name]["t"], float) + R_from_quat(normalized((w, x, y, z))) @ lever_m
