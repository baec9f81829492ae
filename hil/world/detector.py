"""The errors of detectors at level ``sim``, beside the noise of their boxes: misses in spells, and
inventions.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

from drivers.detectors.measured import PEOPLE, BySize, recall_at
from path.bounds import Bounds
from path.values import frozen


@frozen
class DetectorConfig:
    """The ``[world.detector]`` table of a rig: both drones' detectors.

    By default they miss and invent nothing that is not in the noise of the boxes
    (``hil.geometric.noise``).

    Attributes:
        recall: share of the frames that show a thing in which it is found; each thing is missed by
            itself.
        by_size: the same of things whose boxes' longer side is so many px, ascending, between and
            beyond which it is as ``drivers.detectors.measured`` has it; () where size is no matter.
        miss_frames: mean length of a spell of misses, and of one of inventions.
        false_positives: share of the frames with a box somewhere in the image where there is
            nothing.
        edge_px: how far every box lies to the right and down.
    """

    recall: Annotated[float, Bounds(0.0, 1.0, "of 1")] = 1.0
    miss_frames: Annotated[float, Bounds(1.0, 1000.0, "frames")] = 1.0
    false_positives: Annotated[float, Bounds(0.0, 0.9, "of 1")] = 0.0
    edge_px: Annotated[float, Bounds(-100.0, 100.0)] = 0.0
    by_size: Annotated[BySize, Bounds(0.0, 16384.0, "px")] = ()

    def __post_init__(self) -> None:
        sides = [side_px for side_px, _ in self.by_size]
        if sides != sorted(set(sides)) or (sides and sides[0] <= 0.0):
            raise ValueError("by_size: sizes in px above 0, in ascending order")
        if not all(0.0 <= share <= 1.0 for _, share in self.by_size):
            raise ValueError("by_size: the second of each two numbers is a share, 0 to 1")

    def recall_at(self, side_px: float) -> float:
        """Return the share of the frames in which a thing of this size is found."""
        return recall_at(self.by_size, side_px) if self.by_size else self.recall


PERFECT = DetectorConfig()
DRAWN_PX = 190.0  # of the people in drawn frames, and more


def _people(recall: float, miss_frames: float, false_positives: float) -> DetectorConfig:
    """Return what was measured of people in drawn frames of a scene, and of smaller ones in
    photographs, which are of no scene.
    """
    by_size = (*PEOPLE, (DRAWN_PX, recall))
    return DetectorConfig(recall, miss_frames, false_positives, by_size=by_size)


MEASURED: Mapping[tuple[str, str], DetectorConfig] = {
    ("car", "plain"): PERFECT,
    ("car", "overcast"): PERFECT,
    ("drone", "plain"): PERFECT,
    ("drone", "overcast"): PERFECT,
    ("person", "plain"): _people(0.853, 19.6, 0.002),
    ("person", "overcast"): _people(0.883, 17.8, 0.004),
    ("person", "hall"): _people(0.884, 28.9, 0.031),
}
"""By kind of target and scene: YOLOX-nano on people, the colour detector on what is orange
(docs/detectors.md).
"""


def measured_on(kind: str, scene: str) -> DetectorConfig:
    """Return the errors of a detector on such targets in such a scene; the plain one's where none
    was measured.
    """
    return MEASURED.get((kind, scene), MEASURED[kind, "plain"])
