"""A detector that looks at every n-th frame only; between them OpenCV trackers follow what it found, and are checked.

A tracker never says that it follows something else by now. So each track is held against what it was at its last
detection, by looks, size and place, and against the detector itself at every n-th frame; a track that fails is dropped
and the detector asked at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.detectors.opencv_tracker import BoxTracker, TrackerKind
from drivers.interfaces import Detector
from drivers.rig.parts import PartContext, PartSpec, create
from path.agreement import iou
from path.bounds import Bounds
from path.observations import Box, Detection, Region

Image = NDArray[np.uint8]

LOOKS_PX = 24  # side of the small grey image that stands for how a thing looks


@dataclass(frozen=True, slots=True)
class TrackedDetectorConfig:
    """
    Attributes:
        detector: the part that finds things.
        tracker: "csrt" (accurate), "kcf" (faster), "mosse" (keeps the size, gives up often).
        every: the detector looks at every n-th frame.
        min_similarity: correlation, -1..1, of a track's looks with those at its last detection.
        max_growth: factor of a box's side to that at its last detection, or the other way round.
        min_iou: of a track with the detection of the same thing: less is drift, and the detection counts.
        max_tracks: the best detections are tracked.
    """

    detector: PartSpec
    tracker: TrackerKind = "csrt"
    every: Annotated[int, Bounds(1, 1000, "frames")] = 5
    min_similarity: Annotated[float, Bounds(-1.0, 1.0, "of 1")] = 0.5
    max_growth: Annotated[float, Bounds(1.0, 20.0, "times", above=True)] = 1.5
    min_iou: Annotated[float, Bounds(0.0, 1.0, "of 1", above=True)] = 0.4
    max_tracks: Annotated[int, Bounds(1, 100, "tracks")] = 4

    def __post_init__(self) -> None:
        if self.every < 1 or self.max_tracks < 1:
            raise ValueError("every and max_tracks must be at least 1")
        if self.max_growth <= 1.0 or not 0.0 < self.min_iou < 1.0 or not -1.0 < self.min_similarity < 1.0:
            raise ValueError("max_growth must be above 1, min_iou and min_similarity below 1")


@dataclass(slots=True)
class TrackCounters:
    """Counters of frames and tracks by what became of them.

    ``lost``: by the tracker itself; the others by the checks.
    """

    frames: int = 0
    detected: int = 0
    lost: int = 0
    changed_looks: int = 0
    changed_size: int = 0
    drifted: int = 0


@dataclass(frozen=True, slots=True)
class _Track:
    tracker: BoxTracker
    detection: Detection
    looks: NDArray[np.float64]


class TrackedDetector:
    """Implements ``drivers.interfaces.Detector``. It remembers: show it each frame once, in order."""

    Config = TrackedDetectorConfig
    whole_image = True

    def __init__(self, config: TrackedDetectorConfig, context: PartContext) -> None:
        """Raises PartError as the detector in it does."""
        self._config = config
        self._detector: Detector = create(config.detector, context)
        self._tracks: list[_Track] = []
        self._since = 0
        self.counters = TrackCounters()

    def detect(self, image: Image, region: Region | None) -> Sequence[Detection]:
        """Detects as the detector in it.

        What is tracked has the score of its last detection times how like that it looks.
        """
        self.counters.frames += 1
        self._since += 1
        tracked = self._followed(image)
        due = self._since >= self._config.every or tracked is None
        outside = tracked is not None and region is not None and not any(_inside(d, region) for d in tracked)
        if not due and not outside and tracked:
            return [d for d in tracked if region is None or _inside(d, region)]
        found = self._detector.detect(image, region)
        self.counters.detected += 1
        self._since = 0
        for each in tracked or ():
            same = max((iou(each.box, other.box) for other in found), default=0.0)
            self.counters.drifted += 0.0 < same < self._config.min_iou
        self._tracks = [
            self._begun(image, one) for one in found[: self._config.max_tracks] if _has_area(one.box, image)
        ]
        return found

    def _begun(self, image: Image, detection: Detection) -> _Track:
        return _Track(BoxTracker(self._config.tracker, image, detection.box), detection, _looks(image, detection.box))

    def _followed(self, image: Image) -> list[Detection] | None:
        """All tracks in this image; None when one of them failed a check, or there is none."""
        config, found = self._config, list[Detection]()
        for track in self._tracks:
            box, before = track.tracker.update(image), track.detection.box
            if box is None or not _has_area(box, image):
                self.counters.lost += 1
                return None
            growth = max(box.w / before.w, before.w / box.w, box.h / before.h, before.h / box.h)
            if growth > config.max_growth:
                self.counters.changed_size += 1
                return None
            alike = float(np.mean(track.looks * _looks(image, box)))
            if alike < config.min_similarity:
                self.counters.changed_looks += 1
                return None
            found.append(Detection(box, track.detection.score * min(1.0, alike)))
        return sorted(found, key=lambda each: -each.score) if found else None


def _inside(detection: Detection, region: Region) -> bool:
    return region.contains(*detection.box.center)


def _has_area(box: Box, image: Image) -> bool:
    """Returns whether at least two pixels each way are in the image."""
    height, width = image.shape[:2]
    across = min(box.x + box.w, width) - max(box.x, 0.0)
    down = min(box.y + box.h, height) - max(box.y, 0.0)
    return across >= 2.0 and down >= 2.0


def _looks(image: Image, box: Box) -> NDArray[np.float64]:
    """Returns the content of a box as a small grey image of mean 0 and variance 1, whatever the light."""
    height, width = image.shape[:2]
    x0, y0 = max(0, int(box.x)), max(0, int(box.y))
    x1, y1 = min(width, int(box.x + box.w) + 1), min(height, int(box.y + box.h) + 1)
    small = cv2.resize(image[y0:y1, x0:x1], (LOOKS_PX, LOOKS_PX), interpolation=cv2.INTER_AREA)
    grey = np.asarray(cv2.cvtColor(small, cv2.COLOR_BGR2GRAY), np.float64)
    return (grey - grey.mean()) / max(float(grey.std()), 1.0)
