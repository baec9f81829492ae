"""The quick form end to end, and that nothing but truth judges an answer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from missions.ground import rig_library
from missions.ground.work import open_work
from missions.trials.rivals import frame as ambiguity_frame
from missions.trials.rivals import trial as ambiguity
from missions.trials.rivals.frame import (
    FrameTask,
    Owned,
    StagePair,
    ballot,
    path_on,
    renderer_for,
    shoot,
)
from missions.trials.rivals.path import Beliefs, PathAnswer, beliefs
from missions.trials.rivals.report import of_path
from missions.trials.rivals.stage import CAMERAS, MARKER_SIDE_M, Wanted, as_drawn
from missions.trials.rivals.truth import TrueView, shirt_box
from missions.trials.rivals.variants import ORB_VARIANTS
from missions.trials.shared.trial import TrialRequest, TrialResult, trial_part
from path.baselines.orb import Orb
from path.messages import Role
from path.observations import Box

RIG = rig_library.load("sim-rendered")


def task(case: ambiguity.Case, *seed: int) -> FrameTask:
    parts = trial_part(RIG, "renderer"), trial_part(RIG, "errors"), RIG
    return FrameTask(*parts, Wanted(case), seed, None, ORB_VARIANTS[:1], ())


@pytest.fixture(scope="module")
def pair() -> StagePair:
    return shoot(task("present", 1, 4))


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> TrialResult:
    out = tmp_path_factory.mktemp("ambiguity")
    with open_work(1) as work:
        return ambiguity.run(TrialRequest(RIG, out, 3, True, work))


def test_the_quick_trial_counts_every_frame_for_every_method(result: TrialResult) -> None:
    summary = result.summary
    assert (summary["frames"], summary["positives"], summary["negatives"]) == (6, 4, 2)
    assert set(summary["methods"]) == {"path", "path_color", "orb"}
    for method in summary["methods"].values():
        assert method["tp"] + method["tn"] + method["fp"] + method["fn"] == 6
        assert method["tp"] + method["fn"] <= 4
        low, high = method["accuracy_interval"]
        assert low < method["accuracy"] <= high or method["accuracy"] == high == 1.0
    for sweep in summary["sweeps"].values():
        assert len(sweep["methods"]["path"]) == len(sweep["values"]) == 1


def test_without_weights_xfeat_is_left_out_and_the_page_says_so(result: TrialResult) -> None:
    assert result.summary["xfeat"] is False
    assert any("XFeat was left out" in note for note in result.notes)
    assert not any("XFeat" in finding.quantity for finding in result.findings)


def test_goals_are_paths_alone_and_the_papers_figures_are_beside(result: TrialResult) -> None:
    goals = [finding for finding in result.findings if finding.goal]
    assert len(goals) == 2
    assert all(finding.quantity.startswith("PATH, ") for finding in goals)
    assert goals[0].paper == "96.0"


def test_the_full_trial_has_the_papers_counts() -> None:
    assert ambiguity.FRAMES["present"] == 317
    assert ambiguity.FRAMES["outside"] + ambiguity.FRAMES["hidden"] == 33


def test_a_frame_is_the_same_whoever_makes_it(pair: StagePair) -> None:
    again = shoot(task("present", 1, 4))
    assert again.owners == pair.owners
    assert all(np.array_equal(again.shots[role].color, pair.shots[role].color) for role in Role)


def test_owners_are_who_is_at_the_boxes_by_exact_depth(pair: StagePair) -> None:
    scene = pair.scene
    perception = TrueView(
        renderer_for(trial_part(RIG, "renderer"), Role.RECEIVER, scene.side, MARKER_SIDE_M),
        scene,
        Role.RECEIVER,
    )
    for person in range(6):
        shown, hidden = perception.shirt(person)
        assert 0.0 <= shown <= 1.0
        if shown == 1.0:
            assert perception.owner(shirt_box(scene, Role.RECEIVER, person)) == person
            assert hidden == 0.0
    assert perception.owner(Box(3.0, 700.0, 12.0, 12.0)) is None


def test_paths_answer_is_judged_by_truth_alone(
    pair: StagePair, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same candidate is right or wrong by who is in it, whatever PATH or D1 make of it."""
    asked = task("present", 1, 4)
    honest = path_on(asked, pair)
    assert honest.answer.box is not None
    assert honest.owner == 0
    assert honest.answer.agreed
    other = next(i for i in range(1, 6) if i in pair.owners)
    elsewhere = pair.boxes2[pair.owners.index(other)]

    def sure_of_another(*_: object, **__: object) -> PathAnswer:
        return replace(honest.answer, box=elsewhere, agreed=True)

    monkeypatch.setattr(ambiguity_frame, "run_path", sure_of_another)
    wrong = path_on(asked, pair)
    assert wrong.owner == other
    judged = ambiguity_frame.FrameResult(
        pair.scene.wanted, 0.0, 1.0, 0, wrong, wrong, ballot(Orb(), pair, asked.orb_variants), None
    )
    assert of_path(judged, wrong) == "fp"
    assert of_path(judged, Owned(replace(honest.answer, agreed=False), 0)) == "tp"
    assert (
        of_path(
            replace(judged, wanted=replace(judged.wanted, case="hidden")), Owned(honest.answer, 0)
        )
        == "fp"
    )
    assert of_path(judged, Owned(PathAnswer(None, None), None)) == "fn"


def test_without_the_target_nothing_of_it_is_seen() -> None:
    for case in ("outside", "hidden"):
        made = shoot(task(case, 1, 5))
        assert made.visible == 0.0
        assert 0 not in made.owners
        assert any(owner is not None for owner in made.owners)


def test_beliefs_are_wrong_by_the_errors_and_right_without(pair: StagePair) -> None:
    rng = np.random.default_rng(1)

    def believed(level: str) -> Beliefs:
        rig = replace(as_drawn(RIG, pair.scene), world={**RIG.world, "errors": {"level": level}})
        return beliefs(pair.scene, trial_part(RIG, "errors")(rig).session(1), rng)

    wrong, right = believed("careful"), believed("exact")
    assert right.layout.markers[0].side_m == MARKER_SIDE_M
    assert wrong.layout.markers[0].side_m != MARKER_SIDE_M
    assert wrong.camera2.fx != right.camera2.fx == CAMERAS[Role.RECEIVER].fx
    assert abs(np.linalg.norm(wrong.gravity_v) - 1.0) < 1e-9
