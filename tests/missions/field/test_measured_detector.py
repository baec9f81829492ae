"""A detector measured on labelled pictures: found by size and light, edges off, and invented."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from drivers.interfaces import PartError
from drivers.recordings.labels import Label, read_labels
from missions.field.detect import run
from missions.field.measured_detector import Measured, follows, sizes
from missions.ground.options.field import DetectOptions
from path.observations import Box, Detection, Region

ORANGE = (24, 118, 245)
SIZES = {"small": 12, "middle": 30, "large": 60}


@pytest.fixture
def pictures(tmp_path: Path) -> Path:
    """Three pictures of different sizes, each with an orange square of its own size in it."""
    folder = tmp_path / "pictures"
    folder.mkdir()
    for at, (name, side) in enumerate(SIZES.items()):
        picture = np.full((120 + 40 * at, 160 + 40 * at, 3), 90, np.uint8)
        cv2.rectangle(picture, (40, 40), (39 + side, 39 + side), ORANGE, -1)
        cv2.imwrite(str(folder / f"{name}.png"), picture)
    return folder


def coco(folder: Path) -> Path:
    """Labels of the three squares, in pixels from the picture's corner."""
    told = {
        "categories": [{"id": 3, "name": "car"}, {"id": 1, "name": "person"}],
        "images": [{"id": at, "file_name": f"{name}.png"} for at, name in enumerate(SIZES)],
        "annotations": [
            {"image_id": at, "category_id": 3, "bbox": [40, 40, side, side]}
            for at, side in enumerate(SIZES.values())
        ],
    }
    file = folder / "labels.json"
    file.write_text(json.dumps(told), "utf-8")
    return file


def yolo(folder: Path) -> Path:
    labels = folder / "yolo"
    labels.mkdir()
    for at, (name, side) in enumerate(SIZES.items()):
        width, height = 160 + 40 * at, 120 + 40 * at
        u, v = (40 + side / 2) / width, (40 + side / 2) / height
        text = f"2 {u:.6f} {v:.6f} {side / width:.6f} {side / height:.6f}\n"
        (labels / f"{name}.txt").write_text(text, "utf-8")
    return labels


def visdrone(folder: Path) -> Path:
    labels = folder / "visdrone"
    labels.mkdir()
    for name, side in SIZES.items():
        (labels / f"{name}.txt").write_text(f"40,40,{side},{side},1,4,0,0\n", "utf-8")
    return labels


@pytest.mark.parametrize("labelled", [coco, yolo, visdrone])
@pytest.mark.parametrize("regions", [False, True])
def test_labels_of_each_kind_measure_the_same(
    pictures: Path, tmp_path: Path, labelled: Callable[[Path], Path], regions: bool
) -> None:
    out = tmp_path / "out"
    options = DetectOptions(
        pictures, measure=labelled(tmp_path), regions=regions, out=out, rig="sim-rendered"
    )
    said = io.StringIO()
    assert run(options, said) == 0
    record = json.loads((out / "measured.json").read_text("utf-8"))
    assert record["pictures"] == 3
    assert [(each["from_px"], each["labelled"]) for each in record["by_size"]] == [
        (0.0, 1),
        (20.0, 1),
        (60.0, 1),
    ]
    assert record["by_size"][2]["found"] == 1
    assert np.allclose(record["by_size"][2]["bias_px"], 0.0, atol=0.6)
    assert "invented" in said.getvalue()


def seen(*boxes: tuple[Box, float]) -> object:
    def detect(picture: object, region: Region | None) -> list[Detection]:
        return [Detection(box, score) for box, score in boxes]

    return detect


def measured(labels: list[Label], *boxes: tuple[Box, float], grey: int = 120) -> Measured:
    it = Measured()
    it.look(np.full((200, 200, 3), grey, np.uint8), labels, seen(*boxes), regions=False)  # type: ignore[arg-type]
    return it


def test_a_second_box_of_one_object_is_no_second_find_and_none_invented() -> None:
    label = Label("car", Box(50, 50, 40, 40))
    it = measured([label], (Box(51, 50, 40, 40), 0.9), (Box(49, 50, 40, 40), 0.8))
    assert (it.invented, len(it.judged)) == (0, 1)
    assert it.judged[0].off_px == (1.0, 0.0, 1.0, 0.0)


def test_a_box_of_nothing_is_invented_unless_nothing_was_labelled_there() -> None:
    ignored = Label("ignored", Box(100, 100, 80, 80), ignored=True)
    assert measured([ignored], (Box(110, 110, 30, 30), 0.9)).invented == 0
    assert measured([ignored], (Box(10, 10, 30, 30), 0.9)).invented == 1


def test_what_is_missed_counts_by_its_own_size_and_the_pictures_light() -> None:
    it = measured([Label("car", Box(50, 50, 100, 30)), Label("car", Box(5, 5, 9, 9))], grey=30)
    assert [(low, len(of)) for low, _, of in sizes(it.judged)] == [(0.0, 1), (80.0, 1)]
    assert [(name, len(of)) for name, of in it.by_light()] == [("dark", 2)]
    assert it.record()["all"]["found_95"][0] == 0.0


def test_classes_that_are_not_wanted_do_not_count_and_strange_ones_are_told(
    tmp_path: Path,
) -> None:
    file = coco(tmp_path)
    assert read_labels(file, ("car",)).of("small.png") != []
    with pytest.raises(PartError, match="nothing is labelled lorry, but car"):
        read_labels(file, ("lorry",))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("0 40 40 10 10\n", "line 1: YOLO's boxes are shares"),
        ("0 0.5 0.5\n", "line 1: 3 numbers are neither"),
        ("0 0.5 x 0.1 0.1\n", "line 1: could not convert"),
        ("1,1,5,5,1,40,0,0\n", "VisDrone has no category 40"),
    ],
)
def test_a_line_that_is_no_label_is_named(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "a.txt").write_text(text, "utf-8")
    with pytest.raises(PartError, match=said):
        read_labels(tmp_path)


def test_labels_of_other_pictures_are_no_measurement(pictures: Path, tmp_path: Path) -> None:
    other = tmp_path / "others"
    other.mkdir()
    (other / "strange.txt").write_text("0 0.5 0.5 0.1 0.1\n", "utf-8")
    with pytest.raises(PartError, match="none of the 3 pictures"):
        run(DetectOptions(pictures, measure=other), io.StringIO())


def test_what_stays_missed_from_picture_to_picture_is_counted_once() -> None:
    it = Measured()
    label = Label("car", Box(50, 50, 40, 40))
    found = (Box(50, 50, 40, 40), 0.9)
    grey = np.full((200, 200, 3), 120, np.uint8)
    for number, is_found in enumerate("+---+-+"):
        boxes = (found,) if is_found == "+" else ()
        it.look(grey, [label], seen(*boxes), regions=False, name=f"film_{number:04d}")  # type: ignore[arg-type]
    assert it.record()["miss_pictures"] == 2.0  # three and one
    assert follows("a_0009", "a_0010") and not follows("a_0009", "b_0010")
    assert not follows("a_0009", "a_0011") and not follows("", "")


def test_a_picture_in_which_nothing_is_labelled_tells_what_is_invented() -> None:
    it = Measured()
    grey = np.full((200, 200, 3), 120, np.uint8)
    it.look(grey, [], seen((Box(90, 90, 20, 20), 0.8)), regions=True)  # type: ignore[arg-type]
    it.look(grey, [], seen(), regions=True)  # type: ignore[arg-type]
    record = it.record()
    assert (record["looks"], record["looks_inventing"], record["all"]["labelled"]) == (2, 1, 0)
