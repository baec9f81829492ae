"""A measured detector's file: written by ``detect --measure``, drawn from by ``sim``, predicted with
by a plan.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from drivers.detectors.measured import PEOPLE, Rates, read_measured, recall_at
from drivers.interfaces import PartError
from drivers.recordings.labels import Label
from flight.plan.facts import facts_of
from flight.plan.flown import flown
from flight.plan.predictions import predictions
from hil.world.detector import MEASURED
from missions.field.measured_detector import Measured
from missions.ground.rig_library import load, load_unchecked, mission_of
from path.observations import Box, Detection, Region


def written(folder: Path) -> Path:
    """A detector that finds what is 40 px long and more, on 12 grey pictures, and invents in one."""
    measured = Measured()
    boxes = [Box(10, 10, 12, 25), Box(60, 60, 30, 50), Box(140, 60, 30, 90)]

    def detect(picture: object, region: Region | None) -> list[Detection]:
        found = [Detection(box, 0.8) for box in boxes if box.h >= 40]
        nothing = Detection(Box(300, 200, 20, 20), 0.5)
        return found if measured.pictures > 1 else [*found, nothing]

    for number in range(12):
        picture = np.full((300, 400, 3), 60, np.uint8)
        labels = [Label("person", box) for box in boxes]
        measured.look(picture, labels, detect, regions=False, name=f"{number}")  # type: ignore[arg-type]
    file = folder / "measured.json"
    file.write_text(json.dumps(measured.record()), "utf-8")
    return file


def test_what_was_measured_is_read_by_size_and_by_light(tmp_path: Path) -> None:
    file = written(tmp_path)
    rates = read_measured(file)
    assert rates == Rates(((25.0, 0.0), (50.0, 1.0), (90.0, 1.0)), 1.0 / 12.0, 1.0)
    assert read_measured(file, "dim").by_size == rates.by_size
    with pytest.raises(PartError, match="there is no 'bright' in it"):
        read_measured(file, "bright")


def test_between_sizes_recall_goes_with_their_logarithms_and_beyond_them_it_holds() -> None:
    by_size = ((20.0, 0.2), (80.0, 0.8))
    assert [recall_at(by_size, px) for px in (5.0, 20.0, 40.0, 80.0, 900.0)] == pytest.approx(
        [0.2, 0.2, 0.5, 0.8, 0.8]
    )


@pytest.mark.parametrize(
    ("text", "said"),
    [("no", "no measured detector"), ("{}", "there is no 'by_size'"), (None, "No such file")],
)
def test_a_file_of_something_else_is_refused(tmp_path: Path, text: str | None, said: str) -> None:
    file = tmp_path / "m.json"
    if text is not None:
        file.write_text(text, "utf-8")
    with pytest.raises(PartError, match=said) as caught:
        read_measured(file)
    assert "--measure" in caught.value.remedy


def test_a_rig_that_names_it_is_flown_and_planned_with_it(tmp_path: Path) -> None:
    written(tmp_path)
    rig_file = tmp_path / "own.toml"
    rig_file.write_text(
        'name = "own"\nlike = "person"\nlevel = "sim"\n[detector]\nmeasured = "measured.json"\n'
        "[world.detector]\nmiss_frames = 9.0\n",
        "utf-8",
    )
    rig = load(str(rig_file))
    of_world = rig.world["detector"]
    assert of_world["by_size"] == [[25.0, 0.0], [50.0, 1.0], [90.0, 1.0]]
    assert (of_world["miss_frames"], of_world["false_positives"]) == (9.0, 1.0 / 12.0)
    mission = mission_of(rig)
    (found,) = (
        each
        for each in predictions(flown(facts_of(rig, mission), mission))
        if each.key == "found_share"
    )
    assert (found.value, found.said) == (1.0, "100 % of D1's, 100 % of D2's")
    (tmp_path / "measured.json").unlink()
    with pytest.raises(PartError, match="No such file"):
        load_unchecked(str(rig_file))


def test_small_people_are_found_as_in_photographs_and_large_ones_as_in_drawn_frames() -> None:
    for scene, recall in (("plain", 0.853), ("overcast", 0.883), ("hall", 0.884)):
        people = MEASURED["person", scene]
        assert people.recall_at(240.0) == people.recall == recall
        assert [people.recall_at(px) for px, _ in PEOPLE] == [share for _, share in PEOPLE]
