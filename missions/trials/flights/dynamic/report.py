"""The dynamic trial's findings, tables and notes, from its summary and its judged flights."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

from drivers.rig.parts import Rig
from missions.trials.flights.dynamic.flight import TARGET_MPS
from missions.trials.flights.dynamic.judge import RPE_M, RPE_S, SUBJECTS, HarnessVerdict
from missions.trials.flights.errors import COLUMNS, NAMES, OFFSET_GOAL_S, between, cells, mm
from missions.trials.shared.trial import TrialFinding, TrialTable, verdict

MOST_NEES = 1.15  # of a claim that holds, with what sampling may add


def findings(summary: Mapping[str, Any]) -> Sequence[TrialFinding]:
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
        beacons = summary["ape"][name]
        truth = summary["ape_truth"][name]
        found += [
            TrialFinding(
                f"{NAMES[name]} against the beacons, mean, mm",
                mm(beacons["mean_m"]),
                between(beacons["mean_interval_m"]),
                paper=static[name],
                note=f"rms {mm(beacons['rmse_m'])}, of which the beacons' noise alone makes "
                f"{mm(summary['ape_expected_m'][name])}; the paper gives no number for the dynamic part",
            ),
            TrialFinding(
                f"{NAMES[name]} against the truth, mean, mm",
                mm(truth["mean_m"]),
                between(truth["mean_interval_m"]),
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
                note=f"position {mm(coast['error_rms_m'])} mm rms, {mm(coast['sigma_rms_m'])} mm claimed; "
                "1 is exact, less is cautious",
            )
        )
    return found


def noise(
    rig: Rig,
    estimator: Any,
    beacons: Sequence[tuple[str, str]],
) -> TrialTable:
    """``estimator``: dataclass of what the vehicles' own estimates get wrong. ``beacons``: what the
    harness put into theirs.
    """
    rows = [
        ("target", f"{TARGET_MPS:g} m/s round a bent loop, D1 behind it, D2 round D1"),
        ("wind", ", ".join(f"{key} {value:g}" for key, value in rig.world.get("wind", {}).items())),
        (
            "cameras",
            f"{rig.sender.camera.width} x {rig.sender.camera.height}, of level {rig.level}",
        ),
        *(
            (f"own estimate: {part.name}", f"{getattr(estimator, part.name):g}")
            for part in fields(estimator)
        ),
        *beacons,
    ]
    return TrialTable("Noise and systematic errors", ("what", "value"), rows)


def flights(judged: Sequence[HarnessVerdict]) -> TrialTable:
    rows = [
        (
            str(each.facts.seed), each.facts.outcome, f"{each.facts.simulated_s:.0f}",
            f"{each.motions.speed_mps[0]:.2f}", f"{each.motions.speed_mps[1]:.2f}",
            str(len(each.motions.d2.t)), str(len(each.motions.target.t)),
            str(sum(int(u.sum()) for u in each.frame.used)),
        )
        for each in judged
    ]  # fmt: skip
    columns = (
        "seed", "outcome", "s flown", "D1 rms, m/s", "D2 rms, m/s", "D2 poses", "target points",
        "fixes compared",
    )  # fmt: skip
    return TrialTable(
        "Flights",
        columns,
        rows,
        "The views had to agree for longer than usual, to have more to compare.",
    )


def errors(summary: Mapping[str, Any]) -> TrialTable:
    rows: list[tuple[str, ...]] = []
    for name in SUBJECTS:
        for what, key in (("beacons", "ape"), ("truth", "ape_truth")):
            rows.append((f"{NAMES[name]}, {what}", *cells(summary[key][name])))
        for part, over in (("s", f"{RPE_S:g} s"), ("m", f"{RPE_M:g} m")):
            for what, key in (("beacons", "rpe"), ("truth", "rpe_truth")):
                found = summary[key].get(name, {}).get(part)
                if found is not None and found["n"]:
                    rows.append((f"{NAMES[name]}, change over {over}, {what}", *cells(found)))
    alone = ", ".join(
        f"{mm(summary['ape_expected_m'][name])} mm rms for {NAMES[name]}" for name in SUBJECTS
    )
    left = ", ".join(f"{mm(summary['ape_left_m'][name])} mm" for name in SUBJECTS)
    return TrialTable(
        "Absolute and relative errors, mm",
        ("trajectory, reference", *COLUMNS),
        rows,
        f"A beacon's position has {mm(summary['beacon_noise_m'])} mm per axis (measured at rest, before take-off); "
        f"the difference of two, without any error of PATH, gives {alone}. Beacons of 2 cm cannot judge millimetres: "
        f"with their noise taken out, {left} are left, which still hold the warp of their frame, D1's attitude, and "
        "the side of the target.",
    )


def coasts(summary: Mapping[str, Any]) -> TrialTable:
    rows = [
        (
            f"{c['after_s']:g} s", str(c["n"]), mm(c["error_rms_m"]), mm(c["sigma_rms_m"]),
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
    return TrialTable("Without a marker", columns, rows, note)


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
