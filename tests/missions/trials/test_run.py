"""The command: folders, summaries, what is refused, and what a failing trial leaves of the
others.
"""

import importlib
import json
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import get_args

import numpy as np
import pytest

from drivers.interfaces import PartError
from missions.ground import rig_library
from missions.ground.options.proofs import ExperimentName, QuestionName, TrialOptions
from missions.trials import run as command
from missions.trials.questions import EXPERIMENTS, QUESTIONS
from missions.trials.shared.trial import TrialFinding, TrialRequest, TrialResult, trial_part


def trial(
    name: str, monkeypatch: pytest.MonkeyPatch, *, fails: bool = False, needs: tuple[str, ...] = ()
) -> None:
    """Puts a trial of a few numbers in the place of one that takes minutes."""

    def run(request: TrialRequest) -> TrialResult:
        if fails:
            raise ValueError("the lens broke")
        values = np.array([0.5, np.nan]) * request.seed
        return TrialResult(
            {"d2_mean_m": np.float64(0.25), "values": values}, (TrialFinding("error", "0.25 m"),)
        )

    module = ModuleType(name)
    vars(module).update(TITLE=f"The {name} trial", PAPER="", run=run, NEEDS=needs)
    monkeypatch.setitem(sys.modules, EXPERIMENTS[name].module, module)


def test_a_trial_leaves_its_page_and_its_numbers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    trial("static", monkeypatch)
    assert command.run(TrialOptions("static", out=tmp_path / "a", seed=3, jobs=1)) == 0
    summary = json.loads((tmp_path / "a" / "summary.json").read_text())
    assert (summary["trial"], summary["seed"], summary["quick"]) == ("static", 3, False)
    assert (summary["title"], summary["command"]) == (
        "The static trial",
        "path-handoff trial pose --only static --seed 3",
    )
    assert (summary["d2_mean_m"], summary["values"]) == (0.25, [1.5, None])
    assert "The static trial" in (tmp_path / "a" / "index.html").read_text()
    assert "0.25 m" in capsys.readouterr().out


def test_one_that_fails_is_told_and_does_not_take_the_others_with_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in EXPERIMENTS:
        trial(name, monkeypatch, fails=name == "corners")
    assert command.run(TrialOptions("all", out=tmp_path / "all", jobs=1)) == command.EXIT_FAILED
    assert "the lens broke" in capsys.readouterr().err
    overview = json.loads((tmp_path / "all" / "summary.json").read_text())
    assert overview["failed"] == ["corners"]
    assert set(overview["trials"]) == set(EXPERIMENTS) - {"corners"}
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
    options = TrialOptions(
        "all", seed=5, quick=True, xfeat=Path("my models/xfeat.onnx"), rig="my.toml"
    )
    assert command.command(options, "ambiguity") == (
        "path-handoff trial rivals --only ambiguity --seed 5 --rig my.toml --quick --xfeat 'my models/xfeat.onnx'"
    )
    assert (
        command.command(options, "link")
        == "path-handoff trial cost --only link --seed 5 --rig my.toml --quick"
    )


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


def test_a_rig_without_a_part_that_the_trial_needs_is_refused_before_anything_is_flown(
    tmp_path: Path,
) -> None:
    with pytest.raises(PartError, match=r"dynamic-sim\.toml: trials: missing key 'estimator'"):
        command.run(TrialOptions("dynamic", out=tmp_path / "x", quick=True, rig="dynamic-sim"))
    assert not (tmp_path / "x").exists()


@pytest.mark.parametrize("name", ["summary.json", "index.html"])
def test_somebody_elses_page_is_not_written_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    trial("static", monkeypatch)
    (tmp_path / name).write_text("mine")
    with pytest.raises(PartError, match=name):
        command.run(TrialOptions("static", out=tmp_path, jobs=1))
    assert [(file.name, file.read_text()) for file in tmp_path.iterdir()] == [(name, "mine")]


def test_a_trial_goes_on_in_its_own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    trial("static", monkeypatch)
    for _ in range(2):
        assert command.run(TrialOptions("static", out=tmp_path, jobs=1)) == 0


def test_every_experiment_belongs_to_one_question_and_to_its_folder() -> None:
    asked = [name for names in QUESTIONS.values() for name in names]
    assert sorted(asked) == sorted(EXPERIMENTS)
    assert set(get_args(ExperimentName)) == set(EXPERIMENTS)
    assert set(get_args(QuestionName)) == set(QUESTIONS)
    for name, experiment in EXPERIMENTS.items():
        assert experiment.package.split(".")[0] in (command.question_of(name), "real")
        assert importlib.import_module(experiment.module).TITLE


def test_an_experiments_own_name_is_what_only_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    trial("static", monkeypatch)
    for number, options in enumerate(
        (TrialOptions("static"), TrialOptions("pose", only=("static",)))
    ):
        assert command.run(replace(options, out=tmp_path / str(number), seed=3, jobs=1)) == 0
        said = capsys.readouterr().out
        assert ("path-handoff trial pose --only static --seed 3" in said) == (
            options.name == "static"
        )
    first, second = (
        json.loads((tmp_path / str(number) / "summary.json").read_text()) for number in range(2)
    )
    del first["wall_s"], second["wall_s"]
    assert first == second


def test_an_experiment_of_another_question_is_refused_with_its_own() -> None:
    with pytest.raises(PartError, match="--only soak: no part of pose") as refused:
        command.names_of(TrialOptions("pose", only=("soak",)))
    assert refused.value.remedy == "path-handoff trial cost --only soak"


def test_what_each_needs_what_is_left_out_and_what_is_short_is_said_before_anything_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in EXPERIMENTS:
        trial(name, monkeypatch)
    assert command.run(TrialOptions("all", out=tmp_path / "all", jobs=1)) == 0
    said = capsys.readouterr().out.split("[1/")[0]
    assert "recall       rig sim-rendered; in its short form" in said
    assert "soak         rig sitl; in its short form" in said
    assert "compute      rig sim-rendered; without XFeat, whose weights --xfeat names" in said
    assert "real         rig sim-rendered; without all of it" in said
    assert "static       rig sim-rendered\n" in said


def test_of_several_what_cannot_run_is_told_and_the_rest_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in QUESTIONS["pose"]:
        trial(name, monkeypatch, needs=("nothing",) if name == "corners" else ())
    assert command.run(TrialOptions("pose", out=tmp_path / "pose", jobs=1)) == command.EXIT_FAILED
    assert "corners cannot be run" in capsys.readouterr().err
    assert json.loads((tmp_path / "pose" / "summary.json").read_text())["failed"] == ["corners"]
    with pytest.raises(PartError, match="missing key 'nothing'"):
        command.run(TrialOptions("corners", out=tmp_path / "corners", jobs=1))
    assert not (tmp_path / "corners").exists()
