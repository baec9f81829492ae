"""Pairs of frames to look at: one where every method is asked, and what went wrong."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from missions.trials.rivals.frame import FrameResult, FrameTask, StagePair, shoot, xfeat_for
from missions.trials.rivals.pictures import Example, draw_examples
from missions.trials.rivals.report import TITLES, chosen_box, of_path
from missions.trials.rivals.score import Outcome, Rule
from missions.trials.rivals.truth import shirt_box
from missions.trials.shared.trial import TrialRequest
from path.baselines.association import associate
from path.baselines.orb import Orb
from path.messages import Role

WORDS: dict[Outcome, str] = {
    "tp": "the target",
    "fp": "somebody else (false positive)",
    "fn": "nothing (false negative)",
    "tn": "rightly nothing",
}


def draw_view(
    request: TrialRequest,
    tasks: Sequence[FrameTask],
    judged: Sequence[FrameResult],
    rules: Mapping[str, Rule],
) -> str:
    """``examples.png``: PATH right, then a wrong one of each method that has one. Returns the
    caption.
    """
    outcomes: dict[str, list[Outcome]] = {
        "path": [of_path(each, each.path) for each in judged],
        "orb": [e.orb.outcome(rules["orb"]) for e in judged],
    }
    if "xfeat" in rules:
        outcomes["xfeat"] = [e.xfeat.outcome(rules["xfeat"]) if e.xfeat else "tn" for e in judged]
    wanted: list[tuple[str, int]] = [("path", _first(outcomes["path"], ("tp",)) or 0)]
    for method, found in outcomes.items():
        number = _first(found, ("fp",))
        number = _first(found, ("fn",)) if number is None else number
        if number is not None:
            wanted.append((method, number))
    examples = [
        _example(method, tasks[number], judged[number], outcomes[method][number], rules)
        for method, number in wanted
    ]
    draw_examples(examples, request.out / "examples.png")
    return (
        "Pairs of frames, D1's view on the left: one that PATH has right, and of each method the first it has wrong. "
        "Yellow is PATH's search region, lines join verified matches."
    )


def _first(found: Sequence[Outcome], kinds: tuple[Outcome, ...]) -> int | None:
    return next((number for number, each in enumerate(found) if each in kinds), None)


def _example(
    method: str,
    task: FrameTask,
    judged: FrameResult,
    kind: Outcome,
    rules: Mapping[str, Rule],
) -> Example:
    pair = shoot(task)
    images = pair.shots[Role.SENDER].color, pair.shots[Role.RECEIVER].color
    truth = shirt_box(pair.scene, Role.RECEIVER, 0) if judged.visible > 0.0 else None
    title = f"{TITLES[method]}: {WORDS[kind]}"
    if method == "path":
        answer = judged.path.answer
        region = None if answer.prior is None else answer.prior.region
        return Example(
            title,
            images,
            pair.box1,
            answer.box,
            kind == "tp",
            pair.boxes2,
            truth,
            None,
            region,
        )
    return _matched(method, title, task, pair, judged, rules[method], kind)


def _matched(
    method: str,
    title: str,
    task: FrameTask,
    pair: StagePair,
    judged: FrameResult,
    rule: Rule,
    kind: Outcome,
) -> Example:
    variants = task.orb_variants if method == "orb" else task.xfeat_variants
    features = Orb() if method == "orb" or task.xfeat is None else xfeat_for(task.xfeat)
    images = pair.shots[Role.SENDER].color, pair.shots[Role.RECEIVER].color
    _, votes = associate(
        features,
        images[0],
        pair.box1,
        images[1],
        pair.boxes2,
        variants[rule.variant],
    )
    ballot = judged.orb if method == "orb" else judged.xfeat
    box = None if ballot is None else chosen_box(ballot, rule)
    truth = shirt_box(pair.scene, Role.RECEIVER, 0) if judged.visible > 0.0 else None
    return Example(
        title,
        images,
        pair.box1,
        None if box is None else pair.boxes2[box],
        kind == "tp",
        pair.boxes2,
        truth,
        None if box is None else votes.lines[box],
    )
