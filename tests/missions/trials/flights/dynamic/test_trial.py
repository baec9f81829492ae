"""The dynamic trial on one quick flight: what it reports holds together, and rests on records
alone.
"""

from __future__ import annotations

import io
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.beacons.log import Mounted
from drivers.beacons.record import read_any
from drivers.interfaces import BeaconFix, PartError
from drivers.rig.parts import with_errors
from missions.ground import rig_library
from missions.ground.work import open_work
from missions.look.report.records import load_run
from missions.trials.flights.dynamic import trial as dynamic
from missions.trials.flights.dynamic.flight import (
    BEACON_RECORD,
    BeaconTrace,
    Motions,
    heard_of,
    load_motions,
    moving,
    reference_of,
    steadied,
)
from missions.trials.flights.dynamic.judge import clock_of, noise_at_rest
from missions.trials.shared.statistics import blocks_interval
from missions.trials.shared.trajectory import Trajectory
from missions.trials.shared.trial import TrialRequest, TrialResult

# Of seeds 1 to 6 the mean error of the target is 20.8, 16.7, 15.3, 17.6, 15.9 and 16.6 mm: this one
# is in the middle.
SEED = 2
FLIGHT = f"flight-{SEED}"
MOUNTED = {
    name: Mounted(k, (0.0, 0.0, 0.0)) for name, k in (("sender", 5), ("receiver", 6), ("target", 7))
}


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("dynamic")


@pytest.fixture(scope="module")
def result(out: Path) -> TrialResult:
    with open_work(1, io.StringIO()) as work:
        return dynamic.run(
            TrialRequest(
                with_errors(rig_library.load("sim-rendered"), "exact"), out, SEED, True, work
            )
        )


def test_the_summary_is_complete_and_plausible(result: TrialResult) -> None:
    summary: dict[str, Any] = dict(result.summary)
    assert summary["outcomes"] == ["committed"]
    assert abs(summary["time_offset_error_s"]) < 0.025
    assert 0.001 < summary["time_offset_sigma_s"][0] < 0.015
    assert summary["beacon_noise_m"] == pytest.approx(0.02, rel=0.2)
    assert abs(summary["alignment"][0]["yaw_error_rad"]) < math.radians(8.0)
    for name, most_m in (("d2", 0.06), ("target", 0.08)):
        against = summary["ape"][name]
        # a root mean square of n errors is known to one part in the root of 2n
        least = 1.0 - 2.0 / math.sqrt(2.0 * against["n"])
        assert summary["ape_expected_m"][name] * least < against["rmse_m"] < most_m
        assert against["median_m"] < against["p95_m"] <= against["max_m"]
        assert against["mean_interval_m"][0] < against["mean_m"] < against["mean_interval_m"][1]
        assert against["n"] > 30
    # of the mean nothing is said: it hangs on the few first views, from 2.4 m, where a pixel is
    # worth centimetres with corners as noisy as a measured camera's
    assert summary["ape_truth"]["d2"]["median_m"] < 0.010
    assert summary["ape_truth"]["target"]["mean_m"] < 0.02
    assert summary["rpe"]["d2"]["s"]["n"] > 50


def test_coasts_claim_what_they_err(result: TrialResult) -> None:
    coasts = {coast["after_s"]: coast for coast in result.summary["coast"]}
    assert sorted(coasts) == [0.0, 0.2, 0.5, 1.0]
    assert all(coast["n"] > 20 and coast["nees_per_dof"] < 1.15 for coast in coasts.values())
    assert coasts[1.0]["nees_per_dof"] > 0.2
    assert (
        coasts[0.2]["sigma_rms_m"] < coasts[0.5]["sigma_rms_m"] < coasts[1.0]["sigma_rms_m"] < 0.1
    )


def test_report_and_pictures_are_there(result: TrialResult, out: Path) -> None:
    assert all((out / picture).stat().st_size > 10_000 for picture in result.pictures)
    assert all(len(row) == len(table.columns) for table in result.tables for row in table.rows)
    assert result.noise is not None and len(result.noise.rows) > 15
    assert any("no number" in note for note in result.notes)


def records(out: Path) -> tuple[Motions, BeaconTrace]:
    folder = out / FLIGHT
    rig = moving(rig_library.load("sim-rendered"))
    return load_motions(load_run(folder), rig), heard_of(
        read_any(folder / BEACON_RECORD), reference_of(rig).mounted
    )


def test_a_clock_set_wrong_by_0_3_s_is_found_out_on_a_flight(
    result: TrialResult, out: Path
) -> None:
    """To 10 ms."""
    motions, heard = records(out)
    fixes = read_any(out / FLIGHT / BEACON_RECORD)
    late = [
        replace(fix, host_ns=fix.host_ns + 300_000_000) for fix in fixes if fix.host_ns is not None
    ]
    assert len(late) == len(fixes)
    right = clock_of(motions, heard, np.random.default_rng(0))
    wrong = clock_of(motions, heard_of(late, MOUNTED), np.random.default_rng(0))
    assert right.offset_s - wrong.offset_s == pytest.approx(0.3, abs=0.01)
    assert right.offset_s == result.summary["time_offset_s"][0]


def test_what_is_estimated_does_not_know_the_truth(out: Path) -> None:
    """Another frame of the beacons gives another turn, and nothing else."""
    motions, heard = records(out)
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    turned = replace(
        heard,
        paths={name: replace(path, p=path.p @ turn.T + 3.0) for name, path in heard.paths.items()},
    )
    one = clock_of(motions, heard, np.random.default_rng(0))
    other = clock_of(motions, turned, np.random.default_rng(0))
    assert math.remainder(
        other.yaw_rad - one.yaw_rad - 0.5 * math.pi, 2.0 * math.pi
    ) == pytest.approx(0.0, abs=1e-4)
    assert other.offset_s == pytest.approx(one.offset_s, abs=1e-4)
    assert other.scales_m == pytest.approx(one.scales_m, rel=1e-2)


def test_jumps_and_poor_fixes_are_refused() -> None:
    fixes = [
        BeaconFix(k * 125_000_000, a, (0.01 * k, 0.0, 1.0), 90.0)
        for k in range(40)
        for a in (5, 6, 7)
    ]
    fixes[30] = replace(fixes[30], position_m=(5.0, 0.0, 1.0))
    fixes[61] = replace(fixes[61], quality=40.0)
    heard = heard_of(fixes, MOUNTED)
    assert (heard.fixes, heard.refused) == (120, 2)
    assert max(float(path.p[:, 0].max()) for path in heard.paths.values()) < 1.0


def test_intervals_take_blocks_together() -> None:
    """A hundred copies of one error say no more than one."""
    rng = np.random.default_rng(0)
    errors = rng.normal(1.0, 0.3, 30)
    alone = blocks_interval(errors, np.arange(30), np.random.default_rng(1))
    copied = blocks_interval(
        np.repeat(errors, 100), np.repeat(np.arange(30), 100), np.random.default_rng(1)
    )
    assert copied == pytest.approx(alone, rel=1e-6)
    assert alone[0] < 1.0 < alone[1]
    assert all(map(math.isnan, blocks_interval(np.zeros(0), np.zeros(0, np.int64), rng)))


def test_a_rig_without_beacons_is_refused() -> None:
    with pytest.raises(PartError, match=r"\[reference\]: missing table"):
        dynamic.check(rig_library.load("sim"))


def test_reflections_before_take_off_do_not_make_the_beacons_worse() -> None:
    rng = np.random.default_rng(3)
    t = np.linspace(0.0, 14.75, 60, dtype=np.float64)
    still = Trajectory(t, rng.normal(0.0, 0.02, (60, 3)))
    struck = still.p.copy()
    struck[20:25] += 0.7  # as long as the median over five positions follows it
    none = Trajectory(np.zeros(0), np.zeros((0, 3)))
    motions = Motions(none, none, 100.0, none, none, (0.0, 0.0))
    clean, _ = noise_at_rest(motions, BeaconTrace({"receiver": still, "target": none}, 60, 0), 0.0)
    noisy, count = noise_at_rest(
        motions, BeaconTrace({"receiver": Trajectory(t, struck), "target": none}, 60, 0), 0.0
    )
    assert count == 180
    assert clean == pytest.approx(0.02, rel=0.15)
    assert noisy == pytest.approx(clean, rel=0.2)


def test_a_target_that_moves_before_take_off_does_not_make_the_beacons_worse() -> None:
    """What D2's beacon says at rest is all that counts: the target may move from the first second,
    D1 flies first.
    """
    rng = np.random.default_rng(4)
    t = np.linspace(0.0, 14.75, 60, dtype=np.float64)
    still = Trajectory(t, rng.normal(0.0, 0.02, (60, 3)))
    moving_on = Trajectory(t, still.p + 0.3 * t[:, None])
    none = Trajectory(np.zeros(0), np.zeros((0, 3)))
    motions = Motions(none, none, 100.0, none, none, (0.0, 0.0))
    heard = BeaconTrace({"sender": moving_on, "receiver": still, "target": moving_on}, 180, 0)
    noise_m, count = noise_at_rest(motions, heard, 0.0)
    assert count == 180
    assert noise_m == pytest.approx(0.02, rel=0.15)
    nothing = noise_at_rest(motions, replace(heard, paths={**heard.paths, "receiver": none}), 0.0)
    assert math.isnan(nothing[0])
    assert nothing[1] == 0


def test_positions_are_steadied_by_velocities_without_delay() -> None:
    """White noise of 2 cm on a motion to and fro: most of it goes, and the motion stays where it
    was in time.
    """
    rng = np.random.default_rng(5)
    t = np.arange(0.0, 60.0, 0.1, dtype=np.float64)
    true = np.column_stack([np.sin(0.8 * t), np.cos(0.5 * t), 0.1 * t])
    velocity = np.column_stack(
        [0.8 * np.cos(0.8 * t), -0.5 * np.sin(0.5 * t), np.full_like(t, 0.1)]
    )
    found = steadied(t, true + rng.normal(0.0, 0.02, true.shape), velocity)
    error = found - true
    assert np.sqrt(np.mean(error**2)) < 0.008
    late_s = -np.sum(error * velocity) / np.sum(velocity**2)
    assert abs(late_s) < 0.002
