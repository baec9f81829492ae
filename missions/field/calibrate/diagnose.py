"""No board was found: what is in the image instead?"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import cv2
import numpy as np

from path.arrays import Image
from path.calibration.board import Board, other_size
from path.marker.layout import DICTIONARIES
from path.marker.photometric.texture import dictionary_of

FAMILIES = (
    "DICT_4X4_1000",
    "DICT_5X5_1000",
    "DICT_6X6_1000",
    "DICT_7X7_1000",
    "DICT_ARUCO_ORIGINAL",
    "DICT_APRILTAG_36h11",
)
FEWEST = 4  # markers that are no coincidence
LIGHT = "is the whole board in the image, lit evenly, sharp, with a white border around it?"


def what_else(greys: Sequence[Image], board: Board) -> tuple[str, str]:
    """Return what was found in place of the board in some images, and what to do. Markers: of the
    first image.
    """
    nothing = f"no image shows the board ({board.text})"
    if not greys:
        return nothing, "name images of the board"
    found = _markers(greys[0])
    if found is None:
        size = _most_seen(greys) if board.pattern == "chessboard" else None
        if size is not None and size not in {
            (board.columns, board.rows),
            (board.rows, board.columns),
        }:
            squares = f"{size[0]}x{size[1]}"
            return (
                f"{nothing}; there is a chessboard of about {squares} squares",
                "count them again, for --squares",
            )
        return nothing, LIGHT
    name, ids = found
    if board.pattern == "chessboard":
        return (
            f"{nothing}; there are {len(ids)} markers of {name}",
            f"say --board charuco --dictionary {name}",
        )
    if name != board.dictionary:
        return f"{nothing}; there are {len(ids)} markers of {name}", f"say --dictionary {name}"
    return (
        f"{nothing}; there are markers of {name} with ids up to {max(ids)}, but they do not lie as on this board",
        f"count the squares: a board with marker {max(ids)} has at least {2 * max(ids) + 1} of them",
    )


def _most_seen(greys: Sequence[Image]) -> tuple[int, int] | None:
    """The size that most images say a chessboard is of, the longer side first; of equals the larger
    one.

    A board that is cut off or badly lit is a smaller one.
    """
    seen = Counter(
        (max(size), min(size)) for grey in greys if (size := other_size(grey)) is not None
    )
    return max(seen, key=lambda size: (seen[size], size[0] * size[1])) if seen else None


def _markers(grey: Image) -> tuple[str, list[int]] | None:
    """The smallest dictionary that has the markers in an image, and their ids; None when there are
    too few.
    """
    best: tuple[str, list[int]] | None = None
    for name in FAMILIES:  # the smaller ones of a family are its first markers
        _, ids, _ = cv2.aruco.ArucoDetector(dictionary_of(name)).detectMarkers(grey)
        found = [] if ids is None else [int(i) for i in np.ravel(ids)]  # pyright: ignore[reportUnnecessaryComparison]
        if len(found) > (FEWEST if best is None else len(best[1])):
            best = (name, found)
    if best is None:
        return None
    bits = DICTIONARIES[best[0]][0]
    family = [name for name in DICTIONARIES if name.startswith(f"DICT_{bits}X{bits}_")] or [best[0]]
    if best[0] not in family:
        family = [best[0]]
    return min(
        (n for n in family if DICTIONARIES[n][1] > max(best[1])), key=lambda n: DICTIONARIES[n][1]
    ), best[1]
