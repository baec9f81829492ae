"""Trackers between detections: fewer detections, the same boxes, and no track that is believed for being one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.detectors import tracked as tracked_detector
from drivers.detectors.opencv_tracker import BoxTracker, TrackerKind
from drivers.detectors.tracked import TrackedDetector, TrackedDetectorConfig
from drivers.rig.parts import Mount, Origin, PartContext
from drivers.rig.tables import RigError, decode_table
from path.agreement import iou
from path.camera import CameraModel
from path.geometry import Pose
from path.marker.layout import single_marker
from path.messages import Role
from path.observations import Box, Detection, Region

KINDS: tuple[TrackerKind, ...] = ("csrt", "kcf", "mosse")
Image = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class OracleConfig:
    score: float = 0.8


class Oracle:
    """Finds the thing where it is; counts how often it is asked."""

    Config = OracleConfig

    def __init__(self, config: OracleConfig, context: PartContext) -> None:
        self.asked = 0
        self.answer: list[Box] = []
        self._score = config.score

    def detect(self, image: Image, region: Region | None) -> Sequence[Detection]:
        self.asked += 1
        return [Detection(box, self._score) for box in self.answer if region is None or region.contains(*box.center)]


class Clock:
    def now_ns(self) -> int:
        return 0


LEVEL = Pose(np.eye(3), np.zeros(3))
CAMERA = CameraModel(320, 240, 300.0, 300.0, 160.0, 120.0)
CONTEXT = PartContext(Role.SENDER, Clock(), CAMERA, Mount(LEVEL, LEVEL), single_marker(), Origin(0.0, 0.0, 0.0))


def made(**options: object) -> tuple[TrackedDetector, Oracle]:
    table = {"detector": {"factory": f"{__name__}:Oracle"}, **options}
    detector = TrackedDetector(
        decode_table(table, TrackedDetectorConfig, "rig.toml: sender.perception.detector"), CONTEXT
    )
    oracle = detector._detector
    assert isinstance(oracle, Oracle)
    return detector, oracle


RNG = np.random.default_rng(5)
GROUND = cv2.GaussianBlur(RNG.integers(0, 256, (240, 320, 3), np.uint8), (0, 0), 3.0)
THING = cv2.resize(RNG.integers(0, 256, (6, 8, 3), np.uint8), (48, 36), interpolation=cv2.INTER_NEAREST)


def scene(x: int, y: int, thing: Image | None = None) -> tuple[Image, Box]:
    image = np.asarray(GROUND, np.uint8).copy()
    shown = THING if thing is None else thing
    image[y : y + shown.shape[0], x : x + shown.shape[1]] = shown
    return image, Box(x - 0.5, y - 0.5, shown.shape[1], shown.shape[0])


@pytest.mark.parametrize("kind", KINDS)
def test_between_detections_the_thing_is_followed(kind: TrackerKind) -> None:
    detector, oracle = made(tracker=kind, every=5)
    for step in range(16):
        image, true = scene(60 + 3 * step, 80 + step)
        oracle.answer = [true]
        (found,) = detector.detect(image, None)
        assert iou(found.box, true) > 0.75, step
        assert 0.3 < found.score <= 0.8
    if kind != "mosse":  # which often gives up by itself, and is then asked for again
        assert oracle.asked <= 6
    assert detector.counters.frames == 16
    assert detector.counters.detected == oracle.asked
    assert detector.counters.drifted == 0


@pytest.mark.parametrize("kind", KINDS[:2])
def test_a_tracker_gives_fractions_of_a_pixel_back(kind: TrackerKind) -> None:
    image, _ = scene(60, 80)
    start = Box(59.7, 79.8, 48.4, 36.3)
    box = BoxTracker(kind, image, start).update(image)
    assert box is not None
    assert iou(box, start) > 0.93


def test_what_looks_different_is_not_believed() -> None:
    """The thing is gone, and other ground lies where it was: the detector is asked, and finds nothing."""
    detector, oracle = made(every=100)
    image, true = scene(100, 100)
    oracle.answer = [true]
    assert len(detector.detect(image, None)) == 1
    assert len(detector.detect(image, None)) == 1
    assert oracle.asked == 1
    oracle.answer = []
    assert detector.detect(np.asarray(GROUND, np.uint8), None) == []
    assert oracle.asked == 2
    assert detector.counters.lost + detector.counters.changed_looks + detector.counters.changed_size == 1
    assert detector.detect(image, None) == []  # and with nothing to follow it is asked each time
    assert oracle.asked == 3


class Stuck:
    """A tracker that is sure of itself: what it follows stays where it was, or grows."""

    grows = 1.0

    def __init__(self, kind: TrackerKind, image: Image, box: Box) -> None:
        self._box = box

    def update(self, image: Image) -> Box:
        return Box(self._box.x, self._box.y, self.grows * self._box.w, self._box.h)


@pytest.mark.parametrize(("grows", "counter"), [(1.0, "changed_looks"), (1.6, "changed_size")])
def test_a_tracker_that_is_sure_is_checked_all_the_same(
    monkeypatch: pytest.MonkeyPatch, grows: float, counter: str
) -> None:
    monkeypatch.setattr(tracked_detector, "BoxTracker", Stuck)
    detector, oracle = made(every=100)
    image, true = scene(100, 100)
    oracle.answer = [true]
    detector.detect(image, None)
    detector.detect(image, None)
    assert oracle.asked == 1
    monkeypatch.setattr(Stuck, "grows", grows)
    detector.detect(np.asarray(GROUND, np.uint8) if grows == 1.0 else image, None)
    assert oracle.asked == 2
    assert getattr(detector.counters, counter) == 1


def test_what_left_the_search_region_is_asked_for_again() -> None:
    detector, oracle = made(every=100)
    image, true = scene(100, 100)
    oracle.answer = [true]
    detector.detect(image, None)
    assert len(detector.detect(image, Region(90.0, 90.0, 160.0, 150.0))) == 1
    assert oracle.asked == 1
    assert detector.detect(image, Region(200.0, 90.0, 260.0, 150.0)) == []
    assert oracle.asked == 2


def test_a_detection_elsewhere_counts_and_the_drift_is_noted() -> None:
    detector, oracle = made(every=2)
    image, true = scene(100, 100)
    oracle.answer = [true]
    detector.detect(image, None)
    moved = Box(true.x + 25.0, true.y, true.w, true.h)
    oracle.answer = [moved]
    detector.detect(image, None)
    (found,) = detector.detect(image, None)
    assert found.box == moved
    assert detector.counters.drifted == 1


def test_look_alikes_are_followed_too() -> None:
    """Both are given: whoever asks must see that there are two."""
    detector, oracle = made(every=10)
    image, first = scene(40, 60)
    image[150:186, 200:248] = THING
    oracle.answer = [first, Box(199.5, 149.5, 48.0, 36.0)]
    assert len(detector.detect(image, None)) == 2
    assert len(detector.detect(image, None)) == 2
    assert oracle.asked == 1


def test_a_box_at_the_border_or_outside_does_no_harm() -> None:
    detector, oracle = made(every=3)
    image, _ = scene(0, 0)
    oracle.answer = [Box(-20.0, -10.0, 48.0, 36.0), Box(500.0, 500.0, 10.0, 10.0), Box(319.2, 5.0, 30.0, 30.0)]
    for _ in range(6):
        detector.detect(image, None)
    assert oracle.asked >= 2


@pytest.mark.parametrize("options", [{"every": 0}, {"max_growth": 1.0}, {"tracker": "boosting"}, {"min_iou": 2.0}])
def test_options_that_cannot_be_are_refused(options: dict[str, object]) -> None:
    with pytest.raises(RigError, match=r"rig\.toml: sender"):
        made(**options)
