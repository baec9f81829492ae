"""The errors of detectors at level ``sim``, beside the noise of their boxes: misses in spells, and
inventions.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

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
        miss_frames: mean length of a spell of misses, and of one of inventions.
        false_positives: share of the frames with a box somewhere in the image where there is
            nothing.
        edge_px: how far every box lies to the right and down.
    """

    recall: Annotated[float, Bounds(0.0, 1.0, "of 1")] = 1.0
    miss_frames: Annotated[float, Bounds(1.0, 1000.0, "frames")] = 1.0
    false_positives: Annotated[float, Bounds(0.0, 0.9, "of 1")] = 0.0
    edge_px: Annotated[float, Bounds(-100.0, 100.0)] = 0.0


PERFECT = DetectorConfig()

MEASURED: Mapping[tuple[str, str], DetectorConfig] = {
    ("car", "plain"): PERFECT,
    ("car", "overcast"): PERFECT,
    ("drone", "plain"): PERFECT,
    ("drone", "overcast"): PERFECT,
    ("person", "plain"): DetectorConfig(0.853, 19.6, 0.002),
    ("person", "overcast"): DetectorConfig(0.883, 17.8, 0.004),
    ("person", "hall"): DetectorConfig(0.884, 28.9, 0.031),
}
"""By kind of target and scene: YOLOX-nano on people, the colour detector on what is orange
(docs/detectors.md).
"""


def measured_on(kind: str, scene: str) -> DetectorConfig:
    """Return the errors of a detector on such targets in such a scene; the plain one's where none
    was measured.
    """
    return MEASURED.get((kind, scene), MEASURED[kind, "plain"])
