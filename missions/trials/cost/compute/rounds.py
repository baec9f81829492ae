"""The methods' cycles in turns on the same frames, so that whatever slows the machine down hits all
of them alike.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Generator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np

from drivers.clock import busy_ns
from drivers.detectors.xfeat import XFeat
from drivers.log.mcap_log import McapLog
from missions.ground import rig_library
from missions.trials.cost.compute.film import Film, Moment
from missions.trials.cost.compute.path import PathPair
from missions.trials.shared.trial import TrialRequest
from path.arrays import Array
from path.baselines.association import BaselineConfig, associate
from path.baselines.features import Features, FeatureSearch, Image
from path.baselines.orb import Orb
from path.messages import Role
from path.observations import Box
from path.values import frozen

HOT = "geometry_alone"
LEAD_IN = 3  # cycles after the geometry alone, which leaves the marker unseen for a while


@frozen
class ComputePlan:
    """The number of blocks, and of each method's cycles in a block; ``path`` is at least the number
    of frames.
    """

    frames: int = 16
    blocks: int = 12
    path: int = 40
    orb: int = 2
    xfeat: int = 1


QUICK = ComputePlan(frames=4, blocks=3, path=4, orb=1)


Timings = dict[str, Array]
"""The times of one image size: every cycle of a stage or method, us, by block: (blocks, cycles)."""


def median_ms(us: Array) -> float:
    return float(np.median(us)) / 1e3


def p99_ms(us: Array) -> float:
    return float(np.percentile(us, 99.0)) / 1e3


def time_all(
    request: TrialRequest,
    film: Film,
    plan: ComputePlan,
) -> Timings:
    """Every method in every block, one thread. The order within a block turns."""
    with TemporaryDirectory() as folder, ExitStack() as stack:
        logs = {
            role: stack.enter_context(McapLog(Path(folder) / f"{role.value}.mcap", role.value))
            for role in Role
        }
        path = PathPair(request.rig, rig_library.mission_of(request.rig), film, request.seed, logs)
        return _time_all(request, film, plan, path)


def _time_all(
    request: TrialRequest,
    film: Film,
    plan: ComputePlan,
    path: PathPair,
) -> Timings:
    turns: list[Callable[[], dict[str, list[float]]]] = [
        lambda: _of_path(path, plan.path),
        lambda: {HOT: [path.geometry() for _ in range(plan.path)]},
    ]
    for name, features, cycles in _baselines(request, plan):
        turns.append(_turn(f"{name}_boxes", Baseline(features, film, False).cycle, cycles))
        turns.append(_turn(f"{name}_whole", Baseline(features, film, True).cycle, cycles))
        turns.append(_turn(f"{name}_features", Baseline(features, film, True).features, cycles))
    with one_thread():
        for turn in turns:
            turn()  # compiles, and fills what is kept
        collected: list[dict[str, list[float]]] = []
        for block in request.work.steps(f"rounds at {film.size}", range(plan.blocks)):
            order = [turns[(block + k) % len(turns)] for k in range(len(turns))]
            collected.append({name: us for turn in order for name, us in turn().items()})
    return {name: np.array([block[name] for block in collected]) for name in collected[0]}


class Baseline:
    """A baseline on a film: features of D1's and D2's frame, matched, verified, associated with one
    of D2's boxes.

    ``whole``: features of the whole frames, as they come, instead of in enlarged windows around the
    boxes.
    """

    def __init__(
        self,
        features: Features,
        film: Film,
        whole: bool,
    ) -> None:
        self._features = features
        self._film = film
        self._whole = whole
        self._config = (
            replace(BaselineConfig(), look=FeatureSearch(zoom=1.0)) if whole else BaselineConfig()
        )
        self._next = 0

    def cycle(self) -> float:
        """The next pair of frames, us."""
        moment = self._moment()
        one = moment.color[Role.SENDER]
        two = moment.color[Role.RECEIVER]
        box1 = moment.box1
        boxes2 = moment.boxes2
        if self._whole:
            box1 = _all_of(one)
            boxes2 = (_all_of(two),)
        begin_ns = busy_ns()
        associate(self._features, one, box1, two, boxes2, self._config)
        return (busy_ns() - begin_ns) / 1e3

    def features(self) -> float:
        """Features of the next pair of whole frames, and nothing done with them, us."""
        moment = self._moment()
        begin_ns = busy_ns()
        for role in Role:
            self._features.extract(moment.color[role])
        return (busy_ns() - begin_ns) / 1e3

    def _moment(self) -> Moment:
        self._next += 1
        return self._film.moments[self._next % len(self._film.moments)]


def _baselines(request: TrialRequest, plan: ComputePlan) -> list[tuple[str, Features, int]]:
    """XFeat only with its weights. Raises PartError for weights that are none."""
    found: list[tuple[str, Features, int]] = [("orb", Orb(), plan.orb)]
    if request.xfeat is not None:
        found.append(("xfeat", XFeat(request.xfeat, threads=1), plan.xfeat))
    return found


def _turn(
    name: str,
    cycle: Callable[[], float],
    cycles: int,
) -> Callable[[], dict[str, list[float]]]:
    return lambda: {name: [cycle() for _ in range(cycles)]}


def _of_path(path: PathPair, cycles: int) -> dict[str, list[float]]:
    for _ in range(LEAD_IN):
        path.cycle()
    rows = [path.cycle() for _ in range(cycles)]
    return {name: [row[name] for row in rows] for name in rows[0]}


def _all_of(image: Image) -> Box:
    return Box(0.0, 0.0, float(image.shape[1]), float(image.shape[0]))


@contextmanager
def one_thread() -> Generator[None, None, None]:
    """OpenCV on one thread, and nothing loaded by now to be walked by a collection, as in
    flight.
    """
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
        cv2.setNumThreads(threads)
