"""Read what others labelled in pictures: boxes of objects, by the picture's name.

COCO's JSON, YOLO's text files (one a picture, in shares of its size) and VisDrone's (one a picture,
in px). Pixel coordinates are as everywhere in PATH: the middle of the first pixel is (0, 0).
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

from drivers.interfaces import PartError
from drivers.text_file import read_file
from path.observations import Box
from path.values import frozen

MOST_BYTES = 1 << 30  # of a COCO file
REMEDY = "labels are COCO's JSON, or a folder of YOLO's or VisDrone's text files, one a picture"
# VisDrone's categories; 0 is a region in which nothing was labelled, 11 is none of the others
VISDRONE = (
    "ignored",
    "pedestrian",
    "people",
    "bicycle",
    "car",
    "van",
    "truck",
    "tricycle",
    "awning-tricycle",
    "bus",
    "motor",
    "others",
)
YOLO_WORDS = 5
VISDRONE_WORDS = 8


@frozen
class Label:
    """One object, in px, or (``shares``) in shares of its picture's width and height.

    ``ignored``: a region in which nothing is counted, for and against.
    """

    name: str
    box: Box
    shares: bool = False
    ignored: bool = False

    def in_picture(self, width: int, height: int) -> Box:
        """Return its box in the px of a picture."""
        box = self.box
        if not self.shares:
            return box
        return Box(box.x * width - 0.5, box.y * height - 0.5, box.w * width, box.h * height)


class Labels:
    """The labels of a set of pictures. Attributes: ``names``: of all classes that occur."""

    def __init__(self, source: Path, by_picture: dict[str, list[Label]]) -> None:
        self.source = source
        self._by_picture = by_picture
        self.names = sorted({each.name for of in by_picture.values() for each in of})

    def of(self, picture: str) -> list[Label] | None:
        """Return the labels of a picture by its file's name; None for one that nobody labelled."""
        return self._by_picture.get(Path(picture).stem)


def read_labels(source: Path, names: Collection[str] = ()) -> Labels:
    """Return the labels at a path.

    Args:
        source: COCO's JSON file, or a folder of text files.
        names: of the classes that count; everything when empty. YOLO's files have numbers.

    Raises:
        PartError: naming the file, and the line where there is one.
    """
    try:
        found = dict(_of_folder(source)) if source.is_dir() else _of_coco(source)
    except OSError as error:
        raise PartError(f"{source}: {error.strerror}", REMEDY) from error
    if not found:
        raise PartError(f"{source}: no labels in it", REMEDY)
    labels = Labels(source, found)
    unknown = sorted(set(names) - set(labels.names))
    if unknown:
        raise PartError(
            f"{source}: nothing is labelled {', '.join(unknown)}, but {', '.join(labels.names)}",
            "name classes of these labels with --labels",
        )
    if not names:
        return labels
    counted = {
        picture: [each for each in of if each.ignored or each.name in names]
        for picture, of in found.items()
    }
    return Labels(source, counted)


def _of_coco(source: Path) -> dict[str, list[Label]]:
    try:
        told = json.loads(read_file(source, MOST_BYTES))
        categories = {each["id"]: str(each["name"]) for each in told["categories"]}
        pictures = {each["id"]: Path(each["file_name"]).stem for each in told["images"]}
        found: dict[str, list[Label]] = {picture: [] for picture in pictures.values()}
        for each in told["annotations"]:
            label = _of_annotation(each, categories)
            found[pictures[each["image_id"]]].append(label)
    except (ValueError, KeyError, TypeError) as error:
        raise PartError(f"{source}: this is no COCO file: {error}", REMEDY) from error
    return found


def _of_annotation(told: Any, categories: dict[Any, str]) -> Label:
    x, y, w, h = (float(value) for value in told["bbox"])
    crowd = bool(told.get("iscrowd", 0))
    return Label(categories[told["category_id"]], Box(x - 0.5, y - 0.5, w, h), ignored=crowd)


def _of_folder(folder: Path) -> Iterator[tuple[str, list[Label]]]:
    for file in sorted(folder.glob("*.txt")):
        if file.name == "classes.txt":
            continue
        lines = read_file(file).decode("utf-8", "replace").splitlines()
        found = [
            _of_line(line, f"{file}: line {number}")
            for number, line in enumerate(lines, 1)
            if line.strip()
        ]
        yield file.stem, found


def _of_line(line: str, where: str) -> Label:
    words = line.replace(",", " ").split()
    try:
        numbers = [float(word) for word in words]
    except ValueError as error:
        raise PartError(f"{where}: {error}", REMEDY) from error
    if len(words) == YOLO_WORDS:
        return _of_yolo(words[0], numbers, where)
    if len(words) == VISDRONE_WORDS:
        return _of_visdrone(numbers, where)
    raise PartError(f"{where}: {len(words)} numbers are neither YOLO's 5 nor VisDrone's 8", REMEDY)


def _of_yolo(
    name: str,
    numbers: list[float],
    where: str,
) -> Label:
    _, u, v, w, h = numbers
    if not all(0.0 <= share <= 1.0 for share in (u, v, w, h)):
        raise PartError(f"{where}: YOLO's boxes are shares of the picture, 0 to 1", REMEDY)
    return Label(name, Box(u - 0.5 * w, v - 0.5 * h, w, h), shares=True)


def _of_visdrone(numbers: list[float], where: str) -> Label:
    x, y, w, h, counts, category = numbers[:6]
    if not 0 <= category < len(VISDRONE):
        raise PartError(f"{where}: VisDrone has no category {category:g}", REMEDY)
    name = VISDRONE[int(category)]
    ignored = counts == 0.0 or name in ("ignored", "others")
    return Label(name, Box(x - 0.5, y - 0.5, w, h), ignored=ignored)
