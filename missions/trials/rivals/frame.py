"""One pair of frames of the ambiguity trial: drawn, shot, judged by truth, and given to every
method.
"""

from __future__ import annotations

import math
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from drivers.detectors.color import ColorDetector, ColorDetectorConfig
from drivers.interfaces import Detector
from drivers.perception.depth_mask import without_elsewhere
from drivers.rig.parts import Rig
from flight.harness.errors import TrialErrors
from flight.harness.renderer import DepthNoise, FrameRenderer, Shot
from missions.trials.rivals.own import Pair, View, chosen_by
from missions.trials.rivals.path import Beliefs, PathAnswer, beliefs, run_path
from missions.trials.rivals.score import Ballot
from missions.trials.rivals.stage import MARKER_SIDE_M, DrawnStage, Wanted, as_drawn, draw, setup
from missions.trials.rivals.truth import TrueView, shirt_box
from path.baselines.association import BaselineConfig, vote_each
from path.baselines.features import Features, look_each
from path.baselines.orb import Orb
from path.config import MethodConfig
from path.gate.agreement import iou
from path.messages import Role
from path.observations import Box
from path.values import frozen

# of its shirt is in D2's view: the target is present; of stages with less, others are drawn
PRESENT_SHARE = 0.5
# of it is behind other people, and nothing of it to be seen: the target is hidden
HIDDEN_SHARE = 0.6
# D1 sees the target's shirt well, and its detector gives it a box ...
TRACKED_SHARE = 0.75
TRACKED_IOU = 0.4
OWN_SHARE = 0.75  # ... of its own: of the people's pixels in it so many are the target's
# from the middle of a person to its surface; what a tracker keeps of depth
CHEST_M = 0.15
TRACKED_DEPTH_M = 0.45
NOISE_M = DepthNoise().sigma_at_1m_m
REDRAWS = 200


@frozen
class FrameTask:
    """A frame to make, picklable.

    Attributes:
        renderer: the class of the renderer. ``errors``: of the table of errors, which is ``rig``'s.
        xfeat: weights, None without XFeat.
        orb_variants, xfeat_variants: what of the baselines is tried.
        own: a method of somebody's own, ``file.py:Name``.
    """

    renderer: Any
    errors: type[TrialErrors]
    rig: Rig
    wanted: Wanted
    seed: tuple[int, ...]
    xfeat: Path | None
    orb_variants: tuple[BaselineConfig, ...]
    xfeat_variants: tuple[BaselineConfig, ...]
    own: str | None = None


@frozen
class Owned:
    """An answer, and the person that its box really shows (None: no box, or nobody)."""

    answer: PathAnswer
    owner: int | None


@frozen
class FrameResult:
    """The results of one frame.

    Attributes:
        path: PATH's answer, and the person its candidate really shows; ``path_depth`` the same when
            D2's detector looks only where the depth is right.
        redraws: stages thrown away before this one, because what they show was not what was wanted.
    """

    wanted: Wanted
    viewpoint_rad: float
    visible: float
    redraws: int
    path: Owned
    path_color: Owned
    orb: Ballot
    xfeat: Ballot | None
    own: Owned | None = None

    @property
    def present(self) -> bool:
        return self.wanted.case == "present"


@frozen
class StagePair:
    """A stage that shows what was wanted, shot by both cameras."""

    scene: DrawnStage
    shots: dict[Role, Shot]
    box1: Box
    boxes2: tuple[Box, ...]
    owners: tuple[int | None, ...]
    visible: float
    redraws: int


@lru_cache(maxsize=16)
def renderer_for(
    kind: Any,
    role: Role,
    side: int,
    marker_side_m: float,
) -> FrameRenderer:
    return kind(setup(role, side, marker_side_m), 0)


def people_detector() -> Detector:
    """The project's detector, on the shirts of people a few metres away instead of cars."""
    return ColorDetector(
        ColorDetectorConfig(
            min_side_px=45.0,
            max_side_px=500.0,
            split_solidity=0.78,
            merge_gap=0.04,
        )
    )


@lru_cache(maxsize=2)
def xfeat_for(weights: Path) -> Features:
    from drivers.detectors.xfeat import XFeat  # noqa: PLC0415 (onnxruntime only when it is wanted)

    return XFeat(weights)


def shoot(task: FrameTask) -> StagePair:
    """The first stage of the task's seed that shows what is wanted."""
    for redraws in range(REDRAWS):
        rng = np.random.default_rng([*task.seed, redraws])
        pair = _shoot(task, rng, redraws)
        if pair is not None:
            return pair
    raise RuntimeError(f"no stage shows {task.wanted}")


def _shoot(
    task: FrameTask,
    rng: np.random.Generator,
    redraws: int,
) -> StagePair | None:
    scene = draw(task.wanted, rng)
    renderers = {
        Role.SENDER: renderer_for(task.renderer, Role.SENDER, 0, MARKER_SIDE_M),
        Role.RECEIVER: renderer_for(
            task.renderer,
            Role.RECEIVER,
            scene.side,
            task.wanted.marker_side_m,
        ),
    }
    perceptions = {role: TrueView(renderers[role], scene, role) for role in Role}
    if perceptions[Role.SENDER].shirt(0)[0] < TRACKED_SHARE:
        return None
    visible, hidden = perceptions[Role.RECEIVER].shirt(0)
    shown = {
        "present": visible >= PRESENT_SHARE,
        "hidden": visible == 0.0 and hidden >= HIDDEN_SHARE,
    }
    if not shown.get(task.wanted.case, visible == 0.0):
        return None
    seeds = rng.integers(0, 2**31, 2).tolist()
    shots = {
        role: renderers[role].shoot(scene.stage, role, seed)
        for role, seed in zip(Role, seeds, strict=True)
    }
    box1 = _tracked(scene, shots[Role.SENDER])
    if box1 is None or perceptions[Role.SENDER].share(box1, 0) < OWN_SHARE:
        return None
    boxes2 = tuple(each.box for each in people_detector().detect(shots[Role.RECEIVER].color, None))
    owners = tuple(perceptions[Role.RECEIVER].owner(box) for box in boxes2)
    if task.wanted.case != "present" and not any(owner is not None for owner in owners):
        return None
    return StagePair(scene, shots, box1, boxes2, owners, visible, redraws)


def _tracked(scene: DrawnStage, shot: Shot) -> Box | None:
    """Return the detection of D1 nearest to the target's true projection; None when it is not the
    target's box.

    D1's tracker is not under test: it has the target, and knows from the frames before how far away
    it is.
    """
    expected = shirt_box(scene, Role.SENDER, 0)
    depth_m = float(scene.T_w_c(Role.SENDER).inverse().apply(scene.middle_w)[2]) - CHEST_M
    limits_m = depth_m - TRACKED_DEPTH_M, depth_m + TRACKED_DEPTH_M
    shown = without_elsewhere(shot.color, shot.depth_mm, limits_m, NOISE_M)
    found = [each.box for each in people_detector().detect(shown, None)]
    nearest = min(found, key=lambda box: math.dist(box.center, expected.center), default=None)
    return nearest if nearest is not None and iou(nearest, expected) >= TRACKED_IOU else None


def judge(task: FrameTask) -> FrameResult:
    """Every method on one pair of frames."""
    pair = shoot(task)
    network = (
        None if task.xfeat is None else ballot(xfeat_for(task.xfeat), pair, task.xfeat_variants)
    )
    return FrameResult(
        task.wanted,
        pair.scene.viewpoint_rad,
        pair.visible,
        pair.redraws,
        path_on(task, pair),
        path_on(task, pair, depth2=False),
        ballot(Orb(), pair, task.orb_variants),
        network,
        None if task.own is None else own_on(task, task.own, pair),
    )


def believed_on(task: FrameTask, pair: StagePair) -> Beliefs:
    """Return what the drones believe on a pair of frames, of the task's seed.

    Every stage draws it anew, as if it were another pair of drones: otherwise all frames would
    share one error.
    """
    rng = np.random.default_rng([*task.seed, pair.redraws, 1])
    table = task.errors(as_drawn(task.rig, pair.scene))
    return beliefs(pair.scene, table.session(int(rng.integers(1 << 31))), rng)


def owned(
    task: FrameTask,
    pair: StagePair,
    answer: PathAnswer,
) -> Owned:
    """Return an answer with the person that its box really shows."""
    if answer.box is None:
        return Owned(answer, None)
    renderer = renderer_for(
        task.renderer,
        Role.RECEIVER,
        pair.scene.side,
        task.wanted.marker_side_m,
    )
    return Owned(answer, TrueView(renderer, pair.scene, Role.RECEIVER).owner(answer.box))


def own_on(
    task: FrameTask,
    named: str,
    pair: StagePair,
) -> Owned:
    """Return what a method of somebody's own makes of a pair of frames, given what PATH is given."""
    believed = believed_on(task, pair)
    views = {
        role: View(
            pair.shots[role].color,
            believed.depth[role].measured_mm(pair.shots[role].depth_mm),
            camera,
            gravity,
        )
        for role, camera, gravity in (
            (Role.SENDER, believed.camera1, believed.gravity_v),
            (Role.RECEIVER, believed.camera2, believed.gravity_c2),
        )
    }
    given = Pair(
        views[Role.SENDER],
        views[Role.RECEIVER],
        pair.box1,
        pair.boxes2,
        believed.layout,
        believed.T_v_c1,
    )
    return owned(task, pair, PathAnswer(chosen_by(named, given), None))


def path_on(
    task: FrameTask,
    pair: StagePair,
    *,
    depth2: bool = True,
) -> Owned:
    """PATH on a pair of frames."""
    answer = run_path(
        believed_on(task, pair),
        MethodConfig(),
        pair.shots,
        pair.box1,
        people_detector(),
        depth2=depth2,
    )
    return owned(task, pair, answer)


def ballot(
    features: Features,
    pair: StagePair,
    variants: tuple[BaselineConfig, ...],
) -> Ballot:
    """A baseline's votes in each of its variants; what variants share is worked out once."""
    looks = tuple(dict.fromkeys(variant.look for variant in variants))
    own = look_each(features, pair.shots[Role.SENDER].color, [pair.box1], looks)
    theirs = look_each(features, pair.shots[Role.RECEIVER].color, pair.boxes2, looks)
    votes: dict[BaselineConfig, tuple[int, ...]] = {}
    for each in looks:
        alike = [variant for variant in variants if variant.look == each]
        cast = vote_each(features, own[each][0], theirs[each], alike)
        votes |= {variant: vote.inliers for variant, vote in zip(alike, cast, strict=True)}
    return Ballot(
        pair.scene.wanted.case == "present",
        pair.owners,
        tuple(votes[variant] for variant in variants),
    )
