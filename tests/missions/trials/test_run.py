"""The command: folders, summaries, what is refused, and what a failing trial leaves of the others."""

import json
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from drivers.interfaces import PartError
from missions import rig_library
from missions.options.proofs import TrialOptions
from missions.trials import run as command
from missions.trials.shared.trial import TrialFinding, TrialRequest, TrialResult, trial_part


def trial(name: str, monkeypatch: pytest.MonkeyPatch, *, fails: bool = False) -> None:
    """Puts a trial of a few numbers in the place of one that takes minutes."""

    def run(request: TrialRequest) -> TrialResult:
        if fails:
            raise ValueError("the lens broke")
        values = np.array([0.5, np.nan]) * request.seed
        return TrialResult({"d2_mean_m": np.float64(0.25), "values": values}, (TrialFinding("error", "0.25 m"),))

    module = ModuleType(name)
    vars(module).update(TITLE=f"The {name} trial", PAPER="", run=run)
    monkeypatch.setitem(sys.modules, f"missions.trials.{name}.trial", module)


def test_a_trial_leaves_its_page_and_its_numbers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    trial("static", monkeypatch)
    assert command.run(TrialOptions("static", out=tmp_path / "a", seed=3, jobs=1)) == 0
    summary = json.loads((tmp_path / "a" / "summary.json").read_text())
    assert (summary["trial"], summary["seed"], summary["quick"]) == ("static", 3, False)
    assert (summary["title"], summary["command"]) == ("The static trial", "path-handoff trial static --seed 3")
    assert (summary["d2_mean_m"], summary["values"]) == (0.25, [1.5, None])
    assert "The static trial" in (tmp_path / "a" / "index.html").read_text()
    assert "0.25 m" in capsys.readouterr().out


def test_one_that_fails_is_told_and_does_not_take_the_others_with_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in command.NAMES:
        trial(name, monkeypatch, fails=name == "corners")
    assert command.run(TrialOptions("all", out=tmp_path / "all", jobs=1)) == command.EXIT_FAILED
    assert "the lens broke" in capsys.readouterr().err
    overview = json.loads((tmp_path / "all" / "summary.json").read_text())
    assert overview["failed"] == ["corners"]
    assert set(overview["trials"]) == set(command.NAMES) - {"corners"}
    page = (tmp_path / "all" / "index.html").read_text()
    assert "The compute trial" in page
    assert "the lens broke" in page
    assert (tmp_path / "all" / "dynamic" / "summary.json").is_file()


def test_a_file_that_is_not_there_is_refused_before_anything_runs(tmp_path: Path) -> None:
    with pytest.raises(PartError, match=r"--xfeat .*no such file"):
        command.run(TrialOptions("all", out=tmp_path / "all", xfeat=tmp_path / "none.onnx"))
    assert not (tmp_path / "all").exists()


def test_a_rig_that_knows_no_truth_is_refused() -> None:
    with pytest.raises(PartError, match=r"sitl.toml: trials: missing key 'renderer'"):
        trial_part(rig_library.load("sitl"), "renderer")


def test_the_command_that_is_shown_runs_the_same_again() -> None:
    options = TrialOptions("all", seed=5, quick=True, xfeat=Path("my models/xfeat.onnx"), rig="my.toml")
    assert command.command(options, "ambiguity") == (
        "path-handoff trial ambiguity --seed 5 --rig my.toml --quick --xfeat 'my models/xfeat.onnx'"
    )
    assert command.command(options, "link") == "path-handoff trial link --seed 5 --rig my.toml --quick"


def test_a_short_form_meets_no_goal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    trial("static", monkeypatch)
    assert command.run(TrialOptions("static", out=tmp_path, quick=True, jobs=1)) == 0
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert {finding["verdict"] for finding in summary["findings"]} == {"measured"}
    assert 'class="met"' not in (tmp_path / "index.html").read_text()
    assert command.SHORT in (tmp_path / "index.html").read_text()
    assert command.SHORT in capsys.readouterr().out


def test_a_rig_without_a_part_that_the_trial_needs_is_refused_before_anything_is_flown(tmp_path: Path) -> None:
    with pytest.raises(PartError, match=r"dynamic-sim\.toml: trials: missing key 'estimator'"):
        command.run(TrialOptions("dynamic", out=tmp_path / "x", quick=True, rig="dynamic-sim"))
    assert not (tmp_path / "x").exists()


@pytest.mark.parametrize("name", ["summary.json", "index.html"])
def test_somebody_elses_page_is_not_written_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    trial("static", monkeypatch)
    (tmp_path / name).write_text("mine")
    with pytest.raises(PartError, match=name):
        command.run(TrialOptions("static", out=tmp_path, jobs=1))
    assert [(file.name, file.read_text()) for file in tmp_path.iterdir()] == [(name, "mine")]


def test_a_trial_goes_on_in_its_own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    trial("static", monkeypatch)
    for _ in range(2):
        assert command.run(TrialOptions("static", out=tmp_path, jobs=1)) == 0
