"""What a detector finds and invents, by size in the image: measured by ``path-handoff detect
--measure``, drawn from by level ``sim`` and predicted with by plans.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from drivers.interfaces import PartError
from drivers.text_file import read_file
from path.values import frozen

FEWEST = 10  # labels of a size: of fewer a share says little
BySize = tuple[tuple[float, float], ...]

PEOPLE: BySize = ((16.5, 0.16), (31.0, 0.43), (50.0, 0.76), (68.0, 0.85), (92.0, 0.82))
"""Longer side in px and share that is found: YOLOX-nano on 783 people in 185 photographs from
drones, each in a region of its own (docs/detectors.md).
"""


@frozen
class Rates:
    """What a detector does with things of one kind.

    Attributes:
        by_size: longer side of a box in px, and the share of such things that is found; ascending.
        false_positives: share of the images with a box where there is nothing.
        miss_frames: for how many pictures a thing stays missed, as a mean.
    """

    by_size: BySize
    false_positives: float = 0.0
    miss_frames: float = 1.0


def recall_at(by_size: Sequence[tuple[float, float]], side_px: float) -> float:
    """Return the share that is found of things so long in the image: between sizes by their
    logarithms, beyond them as at the last.
    """
    below = [each for each in by_size if each[0] <= side_px]
    above = [each for each in by_size if each[0] > side_px]
    if not below or not above:
        return (above[0] if above else below[-1])[1]
    (small, less), (large, more) = below[-1], above[0]
    return less + (more - less) * math.log(side_px / small) / math.log(large / small)


def read_measured(file: Path, light: str | None = None) -> Rates:
    """Return what was measured.

    Args:
        light: of the pictures that count, as the file names it; None: all.

    Raises:
        PartError: it is no such file, or too little was labelled in it.
    """
    remedy = "measure the detector again: path-handoff detect PICTURES --measure LABELS --regions --out FOLDER"
    try:
        told: dict[str, Any] = json.loads(read_file(file))
        parts = told if light is None else {each["light"]: each for each in told["by_light"]}[light]
        rows = [each for each in parts["by_size"] if each["labelled"] >= FEWEST]
        by_size = tuple((float(each["side_px"]), each["found"] / each["labelled"]) for each in rows)
        invented = float(told["looks_inventing"]) / max(1, int(told["looks"]))
        missed = told["miss_pictures"]
    except OSError as error:
        raise PartError(f"{file}: {error.strerror}", remedy) from error
    except KeyError as error:
        raise PartError(f"{file}: there is no {error} in it", remedy) from error
    except (ValueError, TypeError) as error:
        raise PartError(f"{file}: this is no measured detector: {error}", remedy) from error
    if not by_size:
        raise PartError(f"{file}: of no size {FEWEST} things are labelled", "label more pictures")
    return Rates(by_size, invented, 1.0 if missed is None else max(1.0, float(missed)))
