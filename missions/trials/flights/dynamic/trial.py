"""Both drones and the target moving, PATH's trajectories against an ultrasonic reference.

The mission's own code flies whole hand-overs. What is compared comes from logs: PATH's trajectories
from the roles', the reference from the beacons'. Clock and frame of the beacons are estimated from
these records. The truth of the simulation is used for two things only: to make the beacons' records
up, and to judge beside them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from drivers.rig.parts import Rig
from missions.ground import rig_library
from missions.ground.run_folder import new_folder
from missions.ground.work import call
from missions.trials.flights.beacon.session import fly_session
from missions.trials.flights.dynamic import report
from missions.trials.flights.dynamic.flight import VERIFY_S, moving, reference_of
from missions.trials.flights.dynamic.judge import SUBJECTS, HarnessVerdict, judge, true_places
from missions.trials.flights.dynamic.pictures import draw_coast, draw_errors, draw_map
from missions.trials.flights.errors import alignments, errors_of, spread, tilt_rad
from missions.trials.shared.statistics import blocks_interval, rms
from missions.trials.shared.trial import TrialRequest, TrialResult

TITLE = "Dynamic: PATH's trajectories against ultrasonic beacons while everything moves"
PAPER = "Receiver-View Projection Consistency, dynamic part"
NEEDS = ("beacons", "estimator")

FLIGHTS = 4
QUICK_LEVEL = "sim"
COASTS_S = (0.0, 0.2, 0.5, 1.0)
COAST_SLACK_S = 0.011  # half a frame
QUICK_VERIFY_S = 8.0


def check(rig: Rig) -> None:
    """Raise PartError for a rig without beacons."""
    reference_of(rig)


def run(request: TrialRequest) -> TrialResult:
    rig = request.rig
    # geometric perception instead of rendered frames: the same mission, seconds instead of minutes
    if request.quick:
        quick = rig_library.load(QUICK_LEVEL)
        errors = {key: value for key, value in rig.world.items() if key == "errors"}
        rig = replace(
            quick,
            trials=rig.trials,
            reference=rig.reference,
            world={**quick.world, **errors},
        )
    flights = 1 if request.quick else FLIGHTS
    rig = moving(rig, QUICK_VERIFY_S if request.quick else VERIFY_S)
    seeds = range(request.seed, request.seed + flights)
    flying = [
        partial(fly_session, rig, seed, new_folder(request.out / f"flight-{seed}"))
        for seed in seeds
    ]
    flown = request.work.map("missions flown", call, flying)
    judging = [partial(judge, each, rig) for each in flown]
    judged = request.work.map("flights judged", call, judging)
    beacons = judged[0].session.truth
    assert beacons is not None
    rng = np.random.default_rng([request.seed, 2])
    summary = _summary(judged, rng)
    draw_map(judged[0], request.out / "map.png", true_places(judged[0]))
    draw_errors(judged[0], request.out / "errors.png", judged[0].truth)
    draw_coast(judged, request.out / "coast.png")
    estimator = request.part("estimator")(**rig.world.get("estimator", {}))
    by_seed = {f"seed {each.facts.seed}": each for each in judged}
    return TrialResult(
        summary=summary,
        findings=report.findings(summary),
        noise=report.noise(rig, estimator, beacons.noise),
        tables=(
            report.flights(judged),
            alignments(by_seed),
            report.errors(summary),
            report.coasts(summary),
        ),
        pictures={
            "map.png": "The flight with the first seed from above: left in the beacons' frame, right seen from D1",
            "errors.png": "Errors over time, against the beacons and against the truth",
            "coast.png": "Without a marker: error of the predicted position, and what the filter claims",
        },
        notes=report.notes(summary, request.quick),
    )


def _summary(judged: Sequence[HarnessVerdict], rng: np.random.Generator) -> dict[str, Any]:
    noise = [(each.noise_m, each.noise_samples) for each in judged if each.noise_samples]
    beacon_noise_m = (
        math.sqrt(sum(s * s * n for s, n in noise) / sum(n for _, n in noise))
        if noise
        else math.nan
    )
    expected = {name: rms([each.beacons[name].expected_m for each in judged]) for name in SUBJECTS}
    against = {name: errors_of([each.beacons[name] for each in judged], rng) for name in SUBJECTS}
    return {
        "flights": len(judged),
        "outcomes": [each.facts.outcome for each in judged],
        "time_offset_s": [each.clock.offset_s for each in judged],
        "time_offset_sigma_s": [each.clock.offset_sigma_s for each in judged],
        "time_offset_error_s": max((each.offset_error_s for each in judged), key=abs),
        "time_offset_errors_s": [each.offset_error_s for each in judged],
        "alignment": [
            {
                "yaw_rad": each.frame.yaw_rad,
                "yaw_sigma_rad": each.frame.yaw_sigma_rad,
                "yaw_error_rad": each.yaw_error_rad,
                **{
                    f"shift_{name}_m": each.frame.shifts[k].tolist()
                    for k, name in enumerate(SUBJECTS)
                },
                **{
                    f"shift_{name}_sigma_m": each.frame.shift_sigma_m[k]
                    for k, name in enumerate(SUBJECTS)
                },
                "tilt_if_free_rad": tilt_rad(each),
            }
            for each in judged
        ],
        "beacon_noise_m": beacon_noise_m,
        "ape": against,
        "ape_expected_m": expected,
        "ape_left_m": {
            name: math.sqrt(max(0.0, against[name]["rmse_m"] ** 2 - expected[name] ** 2))
            for name in SUBJECTS
        },
        "ape_truth": {
            name: errors_of([each.truth[name] for each in judged], rng) for name in SUBJECTS
        },
        "rpe": {
            name: {
                "s": spread(np.concatenate([each.beacons[name].rpe_s for each in judged])),
                "m": spread(np.concatenate([each.beacons[name].rpe_m for each in judged])),
            }
            for name in SUBJECTS
        },
        "rpe_truth": {
            "d2": {
                "s": spread(np.concatenate([each.truth["d2"].rpe_s for each in judged])),
                "m": spread(np.concatenate([each.truth["d2"].rpe_m for each in judged])),
            }
        },
        "coast": [_coast(judged, after_s, rng) for after_s in COASTS_S],
    }


def _coast(
    judged: Sequence[HarnessVerdict],
    after_s: float,
    rng: np.random.Generator,
) -> dict[str, Any]:
    errors, sigmas, turns, turn_sigmas, nees, groups = ([] for _ in range(6))
    base = 0
    for each in judged:
        found = each.coasts
        at = np.abs(found.unseen_s - after_s) < (1e-6 if after_s == 0.0 else COAST_SLACK_S)
        errors.append(np.linalg.norm(found.error[at, :3], axis=1))
        turns.append(np.linalg.norm(found.error[at, 3:], axis=1))
        sigmas.append(found.sigma_m[at])
        turn_sigmas.append(found.sigma_rad[at])
        nees.append(found.nees[at])
        groups.append(found.block[at] + base)
        base += int(found.block.max(initial=0)) + 1
    low, high = blocks_interval(np.concatenate(nees), np.concatenate(groups), rng)
    return {
        "after_s": after_s,
        "n": sum(map(len, nees)),
        "error_rms_m": rms(np.concatenate(errors)),
        "sigma_rms_m": rms(np.concatenate(sigmas)),
        "error_rms_rad": rms(np.concatenate(turns)),
        "sigma_rms_rad": rms(np.concatenate(turn_sigmas)),
        "nees_per_dof": float(np.mean(np.concatenate(nees))),
        "nees_interval": [low, high],
    }
