"""The distributions that Monte-Carlo hand-overs are drawn from, in words, for the page of a
trial.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from flight.harness.montecarlo import FaultName
from hil.montecarlo import faults, motion, scene, setup
from hil.montecarlo.scene import Believed
from hil.world.errors import ErrorSizes

MEANINGS: Mapping[FaultName, str] = {
    "none": "nothing but the errors that last and the noise of every frame",
    "marker_occlusion": "the marker is covered once or twice, 0.1-3 s",
    "marker_dropouts": "the marker is missed in 0.5-10 % of the spells of ten frames",
    "flip": "D2's attitude speaks for the other planar solution one to three times, 0.02-1.5 s",
    "depth_holes": "D1 measures no depth on objects one to three times, 0.1-1.5 s",
    "link_loss": "2-50 % of the packets are lost each way",
    "link_delay": "packets are 10-120 ms late with as much jitter, and overtake each other",
    "clock_error": "D2's clock is wrongly known by 5-60 ms",
    "camera_freeze": "one camera gives no frames one to three times, 0.1-1.5 s",
    "attitude_jump": "one drone's attitude is off by 2-12° once or twice, 0.3-4 s",
    "look_alike_near": "a look-alike drives along, 0.3-1.0 m from the target",
    "look_alike_crossing": "a look-alike drives past the target at 1 m/s, 0.36-0.40 m from it",
    "detector_swap": "D2's detector sees a look-alike 0.3-0.8 m beside and not the target, once, 0.3-8 s",
    "mixed": "two of these, at random",
}


def conditions(believed: Believed, sizes: ErrorSizes) -> tuple[tuple[str, str], ...]:
    """(what, how much); standard deviations unless it is a range."""
    noise = believed.noise
    deg = math.degrees
    boxes = believed.boxes
    (behind_m, height_m), others = believed.sender_m, believed.look_alikes
    low, high = scene.SPEED_MPS
    return (
        ("D1 behind and above the target", f"{_span(behind_m)} m, {_span(height_m)} m"),
        ("D2", f"at the planned viewpoint ± {scene.PLACE_SIGMA_M} m per axis and {deg(scene.YAW_SIGMA_RAD):.0f}°"),
        ("target", f"a {believed.kind}; {scene.MOVING_SHARE:.0%} move, {low:g}-{high:g} m/s, "
         f"turning up to {scene.TURN_RAD_S} rad/s"),
        ("look-alikes", f"three, {_span((others.min_distance_m, others.max_distance_m))} m away at first, never below "
         f"{believed.parked_gap_m:g} m; "
         "one drives along, two are parked; identical, at any heading"),
        ("drones hold their places", f"± {motion.WANDER_M[0]} m, tilt {deg(motion.TILT_RAD):.1f}° around a mean tilt "
         f"of 1.5°, yaw {deg(motion.YAW_RAD):.1f}°"),
        ("attitude as estimated", f"bias {0.5 * sizes.tilt_bias:g}° in roll and pitch, {2.0 * sizes.yaw_bias:g}° in "
         f"yaw; noise {sizes.attitude_noise * deg(motion.TILT_NOISE_RAD):.1f}° "
         f"and {deg(motion.YAW_NOISE_RAD):.1f}°"),
        ("velocity as reported", f"{motion.SPEED_NOISE_MPS} m/s; D1's ten times a second"),
        ("printed side", f"{sizes.side:.2%}, once"),
        ("focal length, principal point", f"{sizes.focal:.1%}, {sizes.centre_px:g} px, once, both cameras"),
        ("mounting of both cameras and of the marker", f"{1000 * sizes.mount_m:.0f} mm, "
         f"{sizes.mount_deg:.1f}° per axis, once"),
        ("marker's corners", f"{noise.marker.corner_sigma_px2} px² / side each frame, as measured on rendered frames"),
        ("boxes", f"{boxes.edge_sigma_px} px an edge each frame, outliers and merges as measured on rendered "
         f"frames; {sizes.edge_px} px an edge, once, both detectors"),
        ("depth", f"{sizes.depth:.0%} and {1000 * sizes.depth_bias_m:g} mm too far or near, once; "
         f"{1000 * noise.depth_sigma_at_1m_m:g} mm a pixel and "
         f"{1000 * noise.depth_common_sigma_at_1m_m:g} mm together at 1 m, growing with the square"),
        ("stamps of frames", f"{1000 * sizes.attitude_stamp_s:g} ms, once; {1000 * sizes.stamp_jitter_s:g} ms a frame"),
        ("clocks", f"{1000 * scene.CLOCK_SIGMA_S:.0f} ms, once"),
        ("cameras", f"two, {setup.RATE_HZ:g} Hz, at any phase; "
         f"{_ms(setup.SENDER_LATENCY_S)} and {_ms(setup.RECEIVER_LATENCY_S)} ms until a frame is worked off"),
        ("link", f"{1000 * faults.LINK_DELAY_S:g}-{1000 * (faults.LINK_DELAY_S + faults.LINK_JITTER_S):g} ms, "
         f"{faults.LINK_LOSS:.0%} lost"),
    )  # fmt: skip


def _span(ends: tuple[float, float]) -> str:
    return f"{ends[0]:g}-{ends[1]:g}"


def _ms(ends: tuple[float, float]) -> str:
    return f"{1000 * ends[0]:g}-{1000 * ends[1]:g}"
