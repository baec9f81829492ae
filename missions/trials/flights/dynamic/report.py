"""The dynamic trial's findings, tables and notes, from its summary and its judged flights."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

from drivers.rig.parts import Rig
from missions.trials.flights.dynamic.flight import MIN_QUALITY, TARGET_MPS, FlownSession
from missions.trials.flights.dynamic.judge import RPE_M, RPE_S, SUBJECTS, HarnessVerdict
from missions.trials.shared.trial import TrialFinding, TrialTable, verdict

NAMES = {"d2": "D2 from D1", "target": "the target from D1"}
OFFSET_GOAL_S = 0.010
MOST_NEES = 1.15  # of a claim that holds, with what sampling may add


def _mm(value_m: float | None) -> str:
    return "-" if value_m is None or not math.isfinite(value_m) else f"{1e3 * value_m:.1f}"


def _between(interval: Sequence[float]) -> str:
    return f"{_mm(interval[0])} to {_mm(interval[1])}"


def findings(summary: Mapping[str, Any]) -> tuple[TrialFinding, ...]:
    static = {"d2": "static: 47 mm mean", "target": "static: 30 mm mean"}
    found = [
        TrialFinding(
            "offset of the beacons' clock, worst error, ms",
            f"{1e3 * summary['time_offset_error_s']:.1f}",
            f"claimed sigma {1e3 * max(summary['time_offset_sigma_s']):.1f} at most",
            goal="10",
            verdict=verdict(abs(summary["time_offset_error_s"]) <= OFFSET_GOAL_S),
            note="from both vehicles' own records, with what they say of their own wander and of the frame's warp. "
            "The target drives round a loop, each place is passed in one direction, and a warp of the beacons' frame "
            "then looks like an offset: over 29 such flights it erred by 5 ms rms, as is claimed",
        )
    ]
    for name in SUBJECTS:
        beacons, truth = summary["ape"][name], summary["ape_truth"][name]
        found += [
            TrialFinding(
                f"{NAMES[name]} against the beacons, mean, mm",
                _mm(beacons["mean_m"]),
                _between(beacons["mean_interval_m"]),
                paper=static[name],
                note=f"rms {_mm(beacons['rmse_m'])}, of which the beacons' noise alone makes "
                f"{_mm(summary['ape_expected_m'][name])}; the paper gives no number for the dynamic part",
            ),
            TrialFinding(
                f"{NAMES[name]} against the truth, mean, mm",
                _mm(truth["mean_m"]),
                _between(truth["mean_interval_m"]),
                paper=static[name],
                note="single frames, judged by the harness; no alignment in it",
            ),
        ]
    for coast in summary["coast"]:
        nees, (low, high) = coast["nees_per_dof"], coast["nees_interval"]
        found.append(
            TrialFinding(
                f"error squared over what is claimed, {coast['after_s']:g} s without a marker",
                f"{nees:.2f}",
                f"{low:.2f} to {high:.2f}",
                goal=f"at most {MOST_NEES:g}",
                verdict=verdict(nees <= MOST_NEES),
                note=f"position {_mm(coast['error_rms_m'])} mm rms, {_mm(coast['sigma_rms_m'])} mm claimed; "
                "1 is exact, less is cautious",
            )
        )
    return tuple(found)


def noise(rig: Rig, estimator: Any, flown: FlownSession) -> TrialTable:
    """``estimator``: dataclass of what the vehicles' own estimates get wrong."""
    rows = [
        ("target", f"{TARGET_MPS:g} m/s round a bent loop, D1 behind it, D2 round D1"),
        ("wind", ", ".join(f"{key} {value:g}" for key, value in rig.world.get("wind", {}).items())),
        ("cameras", f"{rig.sender.camera.width} x {rig.sender.camera.height}, of level {rig.level}"),
        *((f"own estimate: {part.name}", f"{getattr(estimator, part.name):g}") for part in fields(estimator)),
        *flown.beacons.noise,
    ]
    return TrialTable("Noise and systematic errors", ("what", "value"), tuple(rows))


def flights(judged: Sequence[HarnessVerdict]) -> TrialTable:
    rows = [
        (
            str(each.flown.seed), each.flown.outcome, f"{each.flown.simulated_s:.0f}",
            f"{each.motions.speed_mps[0]:.2f}", f"{each.motions.speed_mps[1]:.2f}",
            str(len(each.motions.d2.t)), str(len(each.motions.target.t)),
            f"{each.heard.refused} of {each.heard.fixes}", str(sum(int(u.sum()) for u in each.frame.used)),
        )
        for each in judged
    ]  # fmt: skip
    columns = (
        "seed", "outcome", "s flown", "D1 rms, m/s", "D2 rms, m/s", "D2 poses", "target points",
        f"fixes refused (jump, quality below {MIN_QUALITY:g})", "fixes compared",
    )  # fmt: skip
    return TrialTable(
        "Flights", columns, tuple(rows), "The views had to agree for longer than usual, to have more to compare."
    )


def alignments(judged: Sequence[HarnessVerdict]) -> TrialTable:
    rows = [
        (
            str(each.flown.seed),
            f"{each.clock.offset_s:.4f} ± {each.clock.offset_sigma_s:.4f}", f"{1e3 * each.offset_error_s:+.1f}",
            f"{math.degrees(each.frame.yaw_rad):.2f} ± {math.degrees(each.frame.yaw_sigma_rad):.2f}",
            f"{math.degrees(each.yaw_error_rad):+.2f}",
            *(", ".join(_mm(part) for part in each.frame.shifts[k].tolist())
              + f" ± {_mm(each.frame.shift_sigma_m[k])}" for k in range(len(SUBJECTS))),
            f"{math.degrees(math.acos(min(1.0, float(each.free.R[2, 2])))):.2f}",
        )
        for each in judged
    ]  # fmt: skip
    columns = (
        "seed", "clock offset, s", "its error, ms", "turn of the frame, deg", "its error, deg", "shift of D2, mm",
        "shift of the target, mm", "tilt of a free rotation, deg",
    )  # fmt: skip
    note = (
        "± are standard deviations: the offset's from its fit, others from a bootstrap over blocks of 2 s. The turn "
        "contains D1's own heading error, as D1's attitude turns PATH's vectors. The target's shift is the way from "
        "its roof, where the beacon is, to the side that D1 looks at; D2's is what D1's tilt and the warp of the "
        "beacons' frame leave. Errors are judged by the harness."
    )
    return TrialTable("Clock and frame of the beacons, estimated from the records", columns, tuple(rows), note)


def errors(summary: Mapping[str, Any]) -> TrialTable:
    rows: list[tuple[str, ...]] = []
    for name in SUBJECTS:
        for what, key in (("beacons", "ape"), ("truth", "ape_truth")):
            found = summary[key][name]
            rows.append(
                (
                    f"{NAMES[name]}, {what}", str(found["n"]), _mm(found["rmse_m"]), _between(found["rmse_interval_m"]),
                    _mm(found["mean_m"]), _mm(found["median_m"]), _mm(found["p95_m"]), _mm(found["max_m"]),
                )
            )  # fmt: skip
        for part, over in (("s", f"{RPE_S:g} s"), ("m", f"{RPE_M:g} m")):
            for what, found in (("beacons", summary["rpe"][name][part]), ("truth", _truth_rpe(summary, name, part))):
                if found is not None and found["n"]:
                    rows.append(
                        (
                            f"{NAMES[name]}, change over {over}, {what}", str(found["n"]), _mm(found["rmse_m"]), "",
                            _mm(found["mean_m"]), _mm(found["median_m"]), _mm(found["p95_m"]), _mm(found["max_m"]),
                        )
                    )  # fmt: skip
    note = (
        f"A beacon's position has {_mm(summary['beacon_noise_m'])} mm per axis (measured at rest, before take-off); "
        "the difference of two, without any error of PATH, gives "
        + ", ".join(f"{_mm(summary['ape_expected_m'][name])} mm rms for {NAMES[name]}" for name in SUBJECTS)
        + ". Beacons of 2 cm cannot judge millimetres: with their noise taken out, "
        + ", ".join(f"{_mm(summary['ape_left_m'][name])} mm" for name in SUBJECTS)
        + " are left, which still hold the warp of their frame, D1's attitude, and the side of the target."
    )
    columns = ("trajectory, reference", "n", "rmse", "95 %", "mean", "median", "p95", "max")
    return TrialTable("Absolute and relative errors, mm", columns, tuple(rows), note)


def _truth_rpe(summary: Mapping[str, Any], name: str, part: str) -> Mapping[str, Any] | None:
    return summary["rpe_truth"].get(name, {}).get(part)


def coasts(summary: Mapping[str, Any]) -> TrialTable:
    rows = [
        (
            f"{c['after_s']:g} s", str(c["n"]), _mm(c["error_rms_m"]), _mm(c["sigma_rms_m"]),
            f"{math.degrees(c['error_rms_rad']):.2f}", f"{math.degrees(c['sigma_rms_rad']):.2f}",
            f"{c['nees_per_dof']:.2f}", f"{c['nees_interval'][0]:.2f} to {c['nees_interval'][1]:.2f}",
        )
        for c in summary["coast"]
    ]  # fmt: skip
    columns = (
        "without a marker", "n", "position, mm rms", "claimed", "rotation, deg rms", "claimed", "error² / claimed",
        "95 %",
    )  # fmt: skip
    note = (
        "The measurements of the flights replayed through the relative-pose filter with gaps of a second in them. "
        "Error² / claimed is the normalised error squared per degree of freedom, 1 when sigmas are exactly right, less "
        "when they are cautious. Print, lens and mounts differ from what the rig says (docs/errors.md); the claim "
        "allows for print and focal length. A camera whose calibration states no doubts claims to know the centre of "
        "its lens: a pixel there is 2 mm, more than all else that is claimed across the line of sight while the marker "
        "is in view. The true pose is interpolated between 25 Hz: 0.3 mm and 0.03 deg are granted to it."
    )
    return TrialTable("Without a marker", columns, tuple(rows), note)


def notes(summary: Mapping[str, Any], quick: bool) -> tuple[str, ...]:
    lines = [
        "The paper gives no number for its dynamic experiment, only its figure; 47 and 30 mm are from its static one.",
        "Offset, frame and errors against the beacons are estimated from what a crew has: logs of both drones and of "
        "the beacons, and where the beacons are mounted. A constant latency of the beacons cannot be told from their "
        "clock.",
        "The beacons are simulated: real ones also lose lines of sight behind rotors and bodies, which is not in it.",
    ]
    if quick:
        lines.append(
            "Quick form: one flight, and boxes and corners straight from geometry with the noise of rendered ones."
        )
    if any(outcome != "committed" for outcome in summary["outcomes"]):
        lines.append("A flight that did not commit is compared up to where it ended.")
    return tuple(lines)
