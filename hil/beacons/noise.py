"""The errors of an ultrasonic positioning system: noise, warp, reflections, drop-outs, clocks, and
its serial line.

The warp is static: the stationary beacons are surveyed by themselves. The line delays, damages,
cuts and adds bytes.
"""

from __future__ import annotations

import math

import numpy as np

from path.arrays import Array
from path.values import frozen


@frozen
class BeaconConfig:
    """Standard deviations per axis where not said otherwise.

    Attributes:
        rate_hz: of each beacon; they take turns.
        noise_m: new in every position.
        warp_m, warp_length_m: static error of the frame, and over what way it changes.
        reflection_rate, reflection_m: share of the positions at which a row of wrong ones begins (1
            to 3 of them), and how far off these are; two thirds of them are rated poorly by the
            system itself.
        drop_rate, gap_rate, gap_s: single positions missing; gaps, per second, and how long they
            last.
        latency_s, jitter_s: from the ultrasound to the frame, which says it.
        stamp_jitter_s: of the stamped instant itself: ranges to several beacons are not taken at
            one instant.
        wire_s, wire_jitter_s: least way from the frame to the listener, and the mean of what comes
            on top.
        late_rate, late_s: share of the frames that the line holds back, and for how long at most.
        damage_rate: share of the frames that are cut, have a bit turned, or have noise before them,
            each.
        clock_offset_s: of the system's and of the listener's clock, evenly within plus and minus
            this.
        drift_ppm: of both, likewise.
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
    stamp_jitter_s: float = 0.01
    wire_s: float = 0.0015
    wire_jitter_s: float = 0.001
    late_rate: float = 0.005
    late_s: float = 0.15
    damage_rate: float = 0.003
    clock_offset_s: float = 20.0
    drift_ppm: float = 20.0

    @property
    def table(self) -> tuple[tuple[str, str], ...]:
        return (
            ("beacon positions", f"{self.rate_hz:g} Hz each, taking turns"),
            ("noise of a position", f"{1e3 * self.noise_m:g} mm per axis, white"),
            (
                "static warp of the beacons' frame",
                f"{1e3 * self.warp_m:g} mm per axis over {self.warp_length_m:g} m",
            ),
            (
                "reflections",
                f"begin at {100 * self.reflection_rate:g} % of the positions, last 1 to 3 of them, "
                f"{self.reflection_m:g} m per axis; 1/3 with good quality",
            ),
            (
                "missing positions",
                f"{100 * self.drop_rate:g} %, and gaps of {self.gap_s:g} s, {60 * self.gap_rate:g} a minute",
            ),
            (
                "age of a position",
                f"{1e3 * self.latency_s:g} ms, jitter {1e3 * self.jitter_s:g} ms; its frame says it",
            ),
            (
                "stamp of a position",
                f"in whole ms, {1e3 * self.stamp_jitter_s:g} ms from the instant it stands for",
            ),
            (
                "serial line",
                f"{1e3 * self.wire_s:g} ms and {1e3 * self.wire_jitter_s:g} ms more on average, "
                f"{100 * self.late_rate:g} % of the frames held back by up to {1e3 * self.late_s:g} ms; "
                f"{100 * self.damage_rate:g} % each cut, with a wrong bit, after noise",
            ),
            (
                "clocks of the beacons and of who listens",
                f"off by up to {self.clock_offset_s:g} s, drift by up to {self.drift_ppm:g} ppm",
            ),
            ("the beacons' frame", "turned about the vertical by any angle, shifted by up to 10 m"),
        )


class Warp:
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
