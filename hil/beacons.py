"""An ultrasonic positioning system around a run that was flown in simulation: beacons on both drones and the target.

What a system of this kind gets wrong is put onto the truth of the run's log: noise, a static warp of its frame (its
stationary beacons are surveyed by themselves), reflections, drop-outs, latency, a clock and a frame of its own.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.beacon_log import BeaconFix, BeaconTruth, Mounted, write_beacons
from drivers.log import read_log
from path.messages import Vec3
from path.rotation import R_from_quat, R_from_rpy, normalized

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class BeaconConfig:
    """Standard deviations per axis where not said otherwise.

    Attributes:
        rate_hz: of each beacon; they take turns.
        noise_m: new in every position.
        warp_m, warp_length_m: static error of the frame, and over what way it changes.
        reflection_rate, reflection_m: share of the positions at which a row of wrong ones begins (1 to 3 of them), and
            how far off these are; two thirds of them are rated poorly by the system itself.
        drop_rate, gap_rate, gap_s: single positions missing; gaps, per second, and how long they last.
        latency_s, jitter_s: how much later than its instant a position is stamped.
        clock_offset_s: of the system's clock, evenly within plus and minus this; ``drift_ppm`` likewise.
    """

    rate_hz: float = 8.0
    noise_m: float = 0.02
    warp_m: float = 0.012
    warp_length_m: float = 3.0
    reflection_rate: float = 0.01
    reflection_m: float = 0.4
    drop_rate: float = 0.03
    gap_rate: float = 0.02
    gap_s: float = 1.0
    latency_s: float = 0.06
    jitter_s: float = 0.01
    clock_offset_s: float = 20.0
    drift_ppm: float = 20.0

    @property
    def table(self) -> tuple[tuple[str, str], ...]:
        return (
            ("beacon positions", f"{self.rate_hz:g} Hz each, taking turns"),
            ("noise of a position", f"{1e3 * self.noise_m:g} mm per axis, white"),
            ("static warp of the beacons' frame", f"{1e3 * self.warp_m:g} mm per axis over {self.warp_length_m:g} m"),
            (
                "reflections",
                f"begin at {100 * self.reflection_rate:g} % of the positions, last 1 to 3 of them, "
                f"{self.reflection_m:g} m per axis; 1/3 with good quality",
            ),
            (
                "missing positions",
                f"{100 * self.drop_rate:g} %, and gaps of {self.gap_s:g} s, {60 * self.gap_rate:g} a minute",
            ),
            ("latency", f"{1e3 * self.latency_s:g} ms, jitter {1e3 * self.jitter_s:g} ms"),
            ("the beacons' clock", f"off by up to {self.clock_offset_s:g} s, drifts by up to {self.drift_ppm:g} ppm"),
            ("the beacons' frame", "turned about the vertical by any angle, shifted by up to 10 m"),
        )


def listen(world_log: Path, file: Path, seed: int, mounted: Mapping[str, Mounted]) -> BeaconTruth:
    """Write what the beacons of a run would have logged; returns what is true of them.

    Args:
        mounted: by body: "sender", "receiver" (lever in the body, FRD) or "target" (in the frame of an object).

    Raises:
        ValueError: the log holds no truth.
        OSError: a file cannot be read or written.
    """
    config, rng = BeaconConfig(), np.random.default_rng([seed, 0xBEAC])
    stamps_s, paths = _paths(world_log, mounted)
    offset_s, drift = rng.uniform(-config.clock_offset_s, config.clock_offset_s), rng.uniform(-1.0, 1.0)
    yaw, origin = rng.uniform(-math.pi, math.pi), rng.uniform(-10.0, 10.0, 3)
    warp = _Warp(config, rng)
    middle_s = 0.5 * (stamps_s[0] + stamps_s[-1])
    c, s = math.cos(yaw), math.sin(yaw)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    epoch_s = 3600.0  # of the system's clock: it has been on for a while
    fixes: list[BeaconFix] = []
    for turn, (name, path) in enumerate(paths.items()):
        begin_s = stamps_s[0] + turn / len(paths) / config.rate_hz
        instants = np.arange(begin_s, stamps_s[-1], 1.0 / config.rate_hz)
        places = np.column_stack([np.interp(instants, stamps_s, path[:, k]) for k in range(3)])
        places = places + warp.at(places) + rng.normal(0.0, config.noise_m, places.shape)
        quality = np.clip(rng.normal(92.0, 4.0, len(instants)), 0.0, 100.0)
        _reflect(places, quality, config, rng)
        kept = rng.random(len(instants)) >= config.drop_rate
        for gap_s in instants[rng.random(len(instants)) < config.gap_rate / config.rate_hz]:
            kept &= (instants < gap_s) | (instants > gap_s + config.gap_s)
        late = config.latency_s + config.jitter_s * rng.standard_normal(len(instants))
        shown_s = instants + late - offset_s + 1e-6 * config.drift_ppm * drift * (instants - middle_s) + epoch_s
        for k in np.flatnonzero(kept):
            x, y, z = (R @ places[k] + origin).tolist()
            fixes.append(BeaconFix(round(shown_s[k] * 1e9), mounted[name].address, (x, y, z), float(quality[k])))
    write_beacons(file, sorted(fixes, key=lambda fix: (fix.stamp_ns, fix.address)))
    x, y, z = origin.tolist()
    return BeaconTruth(offset_s - config.latency_s - epoch_s, yaw, (x, y, z), config.table)


class _Warp:
    """A smooth static error field: a few waves of random direction."""

    _WAVES = 6

    def __init__(self, config: BeaconConfig, rng: np.random.Generator) -> None:
        directions = rng.standard_normal((self._WAVES, 3))
        lengths = np.linalg.norm(directions, axis=1, keepdims=True)
        self._waves = directions / lengths * (2.0 * math.pi / (2.0 * config.warp_length_m))
        self._phases = rng.uniform(0.0, 2.0 * math.pi, (self._WAVES, 3))
        self._scale = config.warp_m * math.sqrt(2.0 / self._WAVES)

    def at(self, places: Array) -> Array:
        """(n, 3) for places (n, 3)."""
        angles = (places @ self._waves.T)[:, :, None] + self._phases
        return self._scale * np.sin(angles).sum(axis=1)


def _reflect(places: Array, quality: Array, config: BeaconConfig, rng: np.random.Generator) -> None:
    """Put rows of reflections into the positions."""
    for begin in np.flatnonzero(rng.random(len(places)) < config.reflection_rate):
        row = slice(begin, begin + int(rng.integers(1, 4)))
        places[row] += config.reflection_m * rng.standard_normal(3)
        if rng.random() < 2.0 / 3.0:
            quality[row] = rng.uniform(20.0, 70.0)


def _paths(world_log: Path, mounted: Mapping[str, Mounted]) -> tuple[Array, dict[str, Array]]:
    """Instants (n,) of the world's clock in s, and where each beacon truly was (n, 3), in ``w``."""
    target_id, rows = 0, list[tuple[float, dict[str, Any]]]()
    for record in read_log(world_log):
        if record.topic == "/scene":
            target_id = record.record["target_id"]
        elif record.topic == "/truth":
            rows.append((record.stamp_ns * 1e-9, record.record))
    if len(rows) < 2:
        raise ValueError(f"{world_log} holds no truth")
    paths = {
        name: np.array([_place(name, row, target_id, own.lever_m) for _, row in rows]) for name, own in mounted.items()
    }
    return np.array([time_s for time_s, _ in rows]), paths


def _place(name: str, row: dict[str, Any], target_id: int, lever_m: Vec3) -> Array:
    if name == "target":
        _, x, y, z, yaw = next(found for found in row["objects"] if found[0] == target_id)
        return np.array([x, y, z]) + R_from_rpy(0.0, 0.0, yaw) @ lever_m
    w, x, y, z = row[name]["q"]
    return np.array(row[name]["t"], float) + R_from_quat(normalized((w, x, y, z))) @ lever_m
