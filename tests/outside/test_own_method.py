"""A method from outside among the rivals: its row beside ours, on the same frames."""

from __future__ import annotations

from pathlib import Path

import pytest

from drivers.interfaces import PartError
from missions.ground import rig_library
from missions.ground.work import open_work
from missions.trials.rivals import trial
from missions.trials.shared.trial import TrialRequest, TrialResult

HERE = Path(__file__).parent


def asked(method: Path | str, out: Path, monkeypatch: pytest.MonkeyPatch) -> TrialResult:
    monkeypatch.setattr(trial, "QUICK_FRAMES", {"present": 2, "outside": 1, "hidden": 0})
    monkeypatch.setattr(trial, "QUICK_TRIED", 1)
    rig = rig_library.load("sim-rendered")
    with open_work(1) as work:
        return trial.run(TrialRequest(rig, out, 3, True, work, method=str(method)))


def test_an_own_methods_row_is_beside_ours_on_the_same_frames(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = asked(f"{HERE / 'hues.py'}:Hues", tmp_path, monkeypatch)
    methods = result.summary["methods"]
    assert set(methods) == {"path", "path_color", "orb", "own"}
    counted = [sum(methods[name][each] for each in ("tp", "tn", "fp", "fn")) for name in methods]
    assert counted == [3, 3, 3, 3]
    # the nearest in colour is somebody, also where the target is not
    assert methods["own"]["tp"] + methods["own"]["fp"] >= 1
    (row,) = [row for row in result.tables[0].rows if row[0] == "your method"]
    assert f"{HERE / 'hues.py'}:Hues" in row


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("class Mine:\n    pass\n", "it has no choose(pair)"),
        ("class Other:\n    pass\n", "has no Mine"),
        ("class Mine:\n    def choose(self, pair):\n        return 1\n", "choose(pair) returned 1"),
    ],
)
def test_what_is_no_method_is_told_with_what_one_is(
    body: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "mine.py").write_text(body, "utf-8")
    with pytest.raises(PartError) as refused:
        asked(f"{tmp_path / 'mine.py'}:Mine", tmp_path, monkeypatch)
    assert said in str(refused.value) and "--method" in str(refused.value)


def test_the_pages_example_is_the_one_that_is_tried() -> None:
    page = (HERE.parents[1] / "docs" / "own-parts.md").read_text("utf-8")
    assert "(../tests/outside/hues.py)" in page
