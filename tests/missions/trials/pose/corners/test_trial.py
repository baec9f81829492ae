"""The trial of the corners: its views, its methods' honesty about where pixels are, its scores, its
whole.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from hil.camera.pictures import CameraRenderer
from missions.ground import rig_library
from missions.ground.work import open_work
from missions.trials.pose.corners.conditions import (
    CAMERAS,
    CONDITIONS,
    QUICK_MAIN,
    RANGE_M,
    corners_px,
    marker_in,
    view,
)
from missions.trials.pose.corners.methods import METHODS, OPENCV, FoundMarker
from missions.trials.pose.corners.score import score
from missions.trials.pose.corners.shots import CornerShot, shoot
from missions.trials.pose.corners.trial import ERRORS, STRIP, run
from missions.trials.shared.trial import TrialRequest, TrialResult

T_B_V = rig_library.load("sim-rendered").sender.mount.T_b_v


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("corners")


@pytest.fixture(scope="module")
def result(folder: Path) -> TrialResult:
    with open_work(1) as work:
        return run(TrialRequest(rig_library.load("sim-rendered"), folder, 3, True, work))


def test_every_condition_and_method_is_in_the_summary(result: TrialResult) -> None:
    conditions = result.summary["conditions"]
    assert list(conditions) == list(CONDITIONS)
    for condition, by_method in conditions.items():
        assert "photometric" in by_method, condition
        for own in by_method.values():
            assert own["rms_px"] > 0.0
            assert own["rms_interval_px"][0] <= own["rms_px"] <= own["rms_interval_px"][1]
            assert 0.0 < own["found"] <= 1.0
    assert result.summary["camera"] == QUICK_MAIN


def test_the_photometric_fit_is_best_by_far_on_ideal_images(result: TrialResult) -> None:
    ideal = result.summary["conditions"]["ideal"]
    assert ideal["photometric"]["rms_px"] < 0.04
    assert all(
        ideal[m]["rms_px"] > 1.3 * ideal["photometric"]["rms_px"] for m in METHODS if m in OPENCV
    )
    assert ideal["subpix"]["radial_px"] < -0.1
    assert "calibration" in ideal["photometric"] and "calibration" not in ideal["contour"]


def test_findings_noise_tables_and_pictures_are_there(result: TrialResult, folder: Path) -> None:
    assert set(result.pictures) == {ERRORS, STRIP}
    for picture in result.pictures:
        assert (folder / picture).read_bytes()[:4] == b"\x89PNG"
    assert result.noise is not None
    named = " ".join(" ".join(row) for row in result.noise.rows)
    assert all(
        word in named for word in ("ink_spread_m 0.0001", "h264_crf 23", "sharpen 1.0", "0.7–1.5 m")
    )
    assert any(finding.goal and finding.verdict == "met" for finding in result.findings)
    assert all(
        len(row) == len(table.columns)
        for table in (result.noise, *result.tables)
        for row in table.rows
    )


def test_views_are_within_what_they_say_and_the_same_for_every_camera() -> None:
    incidences, ranges = [], []
    for number in range(60):
        for name, camera in CAMERAS.items():
            seen = view(0, number, camera, T_B_V)
            T_c_v = marker_in(seen, T_B_V)
            assert np.abs(T_c_v.R @ T_c_v.R.T - np.eye(3)).max() < 1e-12
            corners = corners_px(T_c_v, camera)
            assert np.all(
                (corners > 20.0) & (corners < np.array([camera.width, camera.height]) - 20.0)
            )
            if name == QUICK_MAIN:
                toward = -T_c_v.t / np.linalg.norm(T_c_v.t)
                incidences.append(math.degrees(math.acos(float(T_c_v.R[:, 2] @ toward))))
                ranges.append(float(np.linalg.norm(T_c_v.t)))
    assert 45.0 < max(incidences) <= 60.0 + 1e-6
    assert min(incidences) < 12.0
    assert RANGE_M[0] <= min(ranges) < 0.8 and 1.4 < max(ranges) <= RANGE_M[1]


def test_no_method_is_off_by_a_convention() -> None:
    """Mean error over corners that point everywhere: half a pixel of an enlarged image would be
    0.125 px.
    """
    camera = QUICK_MAIN
    samples = shoot(CameraRenderer, T_B_V, camera, "ideal", 1, range(6), shown=-1)
    for method in METHODS:
        errors = [
            found.corners_px - s.true_px for s in samples if (found := s.found[method]) is not None
        ]
        assert len(errors) == 6
        if method != "subpix":  # it is off by more than that at single corners
            assert np.abs(np.mean(errors, axis=(0, 1))).max() < 0.06, method


def test_the_same_shots_come_from_any_split_of_the_views() -> None:
    whole = shoot(CameraRenderer, T_B_V, QUICK_MAIN, "realistic", 2, (0, 1), shown=1)
    part = shoot(CameraRenderer, T_B_V, QUICK_MAIN, "realistic", 2, (1,), shown=1)
    assert whole[0].picture is None
    assert whole[1].picture is not None and part[0].picture is not None
    assert np.array_equal(whole[1].picture, part[0].picture)
    a, b = whole[1].found["photometric"], part[0].found["photometric"]
    assert a is not None and b is not None
    assert np.array_equal(a.corners_px, b.corners_px)


def made_up(sigma_px: float, stated_px: float, radial_px: float, views: int) -> list[CornerShot]:
    rng = np.random.default_rng(0)
    true_px = np.array([[100.0, 100.0], [140.0, 100.0], [140.0, 140.0], [100.0, 140.0]])
    out = (true_px - 120.0) / np.hypot(20.0, 20.0)
    return [
        CornerShot("", "", k, true_px, {"m": None if k % 4 == 3 else FoundMarker(
            true_px + radial_px * out + rng.normal(0.0, sigma_px, (4, 2)), stated_px**2 * np.eye(8))})
        for k in range(views)
    ]  # fmt: skip


def test_scores_are_what_was_put_in() -> None:
    own = score(made_up(0.05, 0.1, 0.0, 400), "m", 0)
    assert own is not None
    assert own.rms_px == pytest.approx(0.05, rel=0.05)
    assert own.robust_px == pytest.approx(0.05, rel=0.07)
    assert own.found == 0.75
    assert own.calibration == pytest.approx(0.25, rel=0.08)
    assert own.interval_px[0] < 0.05 < own.interval_px[1]
    pulled = score(made_up(0.01, 0.1, -0.3, 40), "m", 0)
    assert pulled is not None
    assert pulled.radial_px == pytest.approx(-0.3, abs=0.01)
    assert score([s for s in made_up(0.1, 0.1, 0.0, 8) if s.view % 4 == 3], "m", 0) is None
