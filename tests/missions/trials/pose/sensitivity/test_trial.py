from __future__ import annotations

from pathlib import Path

import pytest

from missions.ground import rig_library
from missions.ground.work import open_work
from missions.trials.pose.sensitivity.trial import run
from missions.trials.shared.trial import TrialRequest, TrialResult


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> TrialResult:
    with open_work(1) as work:
        return run(
            TrialRequest(rig_library.load("sim"), tmp_path_factory.mktemp("trial"), 5, True, work)
        )


def test_the_summary_reproduces_the_paper(result: TrialResult) -> None:
    summary = result.summary
    assert summary["nominal_px"] == pytest.approx((540.08, 685.69), abs=0.01)
    assert summary["depth_rms_px"] == pytest.approx(2.56, abs=0.01)
    # the quick form tries few directions
    assert summary["pose_rms_px"] == pytest.approx(17.22, abs=0.1)
    assert summary["combined_rms_px"] == pytest.approx(17.41, abs=0.1)
    assert summary["diagonal_percent"] == pytest.approx(0.79, abs=0.005)


@pytest.mark.parametrize(
    ("law", "ends"),
    [
        ("constant", (13.21, 21.44)),
        ("linear", (12.84, 21.52)),
        ("power_1.5", (12.75, 21.59)),
        ("quadratic", (12.70, 21.70)),
    ],
)
def test_every_law_of_the_depth_error_has_its_range(
    result: TrialResult, law: str, ends: tuple[float, float]
) -> None:
    assert result.summary["range_px"][law] == pytest.approx(ends, abs=0.2)


def test_the_law_is_stated_and_the_marker_outside_the_image_is_told(result: TrialResult) -> None:
    stated = [finding for finding in result.findings if "Z^1.5" in finding.quantity]
    assert len(stated) == 1 and stated[0].verdict == "met"
    assert any("outside D2's image" in note for note in result.notes)
    assert result.noise is not None


def test_the_picture_is_there(tmp_path: Path) -> None:
    with open_work(1) as work:
        result = run(TrialRequest(rig_library.load("sim"), tmp_path, 5, True, work))
    assert [(tmp_path / picture).read_bytes()[:4] for picture in result.pictures] == [b"\x89PNG"]
