"""The marker's pose timed on photographs, here on rendered ones."""

from __future__ import annotations

from pathlib import Path

import cv2
import pytest

from drivers.interfaces import PartError
from missions.trials.cost.compute.photographs import time_photographs
from missions.trials.cost.compute.trial import _real_findings
from tests.missions.trials.real.test_trial import PRINTED, TEXT, Held, photographs, poses


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("set")
    (folder / "views").mkdir()
    for number, color in enumerate(photographs(PRINTED, list(poses(PRINTED, Held(), 3, 21)), 7)):
        cv2.imwrite(str(folder / "views" / f"{number}.png"), color)
    (folder / "rendered.toml").write_text(TEXT.format(more=""))
    return folder / "rendered.toml"


def test_every_marker_is_timed_in_each_photograph_after_its_first_and_held_against_the_goals(
    file: Path,
) -> None:
    timed = time_photographs(file, None, 0)
    assert len(timed.us) > 10
    assert len(timed.opencv_us) == 3
    assert timed.poses > 0.9
    median, p99, search = _real_findings([timed])
    assert float(median.ours) <= float(p99.ours)
    assert "median, 640x480" in median.quantity
    assert "OpenCV's detector" in p99.note
    assert {median.verdict, p99.verdict, search.verdict} <= {"met", "short"}
    assert len(timed.search_us) == 3 and "searched for everywhere" in search.quantity


def test_a_set_whose_markers_no_rig_can_name_is_refused(file: Path) -> None:
    odd = file.with_name("odd.toml")
    odd.write_text(file.read_text().replace('pattern = "charuco"', 'pattern = "chessboard"'))
    with pytest.raises(PartError, match=r"odd\.toml"):
        time_photographs(odd, None, 0)
