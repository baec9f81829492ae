"""The marker as it is printed: found by a detector where the rig's tables say it is."""

from __future__ import annotations

import io
import re
import tomllib
from pathlib import Path
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.interfaces import PartError
from missions.field.calibrate.run import run
from missions.ground.options.calibrate import CalibrateMarkerOptions, CalibrateOptions
from path.marker.photometric.texture import dictionary_of

PX = 10  # in a mm
SVG = "{http://www.w3.org/2000/svg}"
CELL = re.compile(r"M([\d.]+) ([\d.]+)h([\d.]+)v([\d.]+)h-[\d.]+z")


def drawn(options: CalibrateMarkerOptions) -> str:
    said = io.StringIO()
    assert run(CalibrateOptions(options), said) == 0
    return said.getvalue()


def printed(file: Path) -> NDArray[np.uint8]:
    """The drawing on paper: black cells as they are in it, in its millimetres."""
    svg = ElementTree.fromstring(file.read_text("utf-8"))
    width_mm, height_mm = (float(svg.attrib[key].removesuffix("mm")) for key in ("width", "height"))
    assert svg.attrib["viewBox"] == f"0 0 {width_mm:.4f} {height_mm:.4f}"
    paper = np.full((round(height_mm * PX), round(width_mm * PX)), 255, np.uint8)
    for path in svg.iter(f"{SVG}path"):
        for cell in CELL.findall(path.attrib["d"]):
            x, y, across, down = (float(each) * PX for each in cell)
            paper[round(y) : round(y + down), round(x) : round(x + across)] = 0
    return paper


@pytest.mark.parametrize(
    "options",
    [
        CalibrateMarkerOptions(),
        CalibrateMarkerOptions(ids=(7, 3, 12), side_m=0.03, gap_m=0.011, dictionary="DICT_5X5_100"),
        CalibrateMarkerOptions(ids=(1, 2), dictionary="DICT_APRILTAG_36h11"),
    ],
    ids=["one", "three", "apriltag"],
)
def test_a_detector_finds_what_the_rigs_tables_say(
    options: CalibrateMarkerOptions, tmp_path: Path
) -> None:
    file = tmp_path / "marker.svg"
    options = CalibrateMarkerOptions(
        options.ids, options.side_m, options.gap_m, options.dictionary, file
    )
    said = drawn(options)
    cell_mm = 1e3 * options.side_m / (dictionary_of(options.dictionary).markerSize + 2)
    assert (
        f"Leave the white around it: {cell_mm:.1f} mm are needed, {1.5 * cell_mm:.1f} mm are drawn"
        in said
    )
    assert ("AprilTags are turned by 180 degrees" in said) == ("APRILTAG" in options.dictionary)
    rig = tomllib.loads(said.split("into the rig:\n\n")[1])
    assert rig.get("marker_dictionary", "DICT_4X4_50") == options.dictionary
    found, ids, _ = cv2.aruco.ArucoDetector(dictionary_of(options.dictionary)).detectMarkers(
        printed(file)
    )
    assert ids is not None
    seen = {
        int(each): corners.reshape(4, 2) / PX
        for each, corners in zip(ids.ravel(), found, strict=True)
    }
    tables = {table["id"]: table for table in rig["markers"]}
    assert set(seen) == set(tables) == set(options.ids)
    middle = np.mean([corners.mean(axis=0) for corners in seen.values()], axis=0)
    for marker_id, corners in seen.items():
        x_m, y_m, _ = tables[marker_id].get("position_v_m", (0.0, 0.0, 0.0))
        assert np.linalg.norm(corners[1] - corners[0]) == pytest.approx(
            1e3 * tables[marker_id]["side_m"], abs=0.3
        )
        assert corners.mean(axis=0) - middle == pytest.approx([1e3 * x_m, -1e3 * y_m], abs=0.3)
        assert corners[0][0] < corners[1][0] and corners[0][1] < corners[3][1]  # upright as printed


def test_the_same_drawing_is_written_again_and_another_is_not_written_over(tmp_path: Path) -> None:
    file = tmp_path / "marker.svg"
    assert drawn(CalibrateMarkerOptions(out=file)) == drawn(CalibrateMarkerOptions(out=file))
    with pytest.raises(PartError, match="is another drawing"):
        drawn(CalibrateMarkerOptions(ids=(1,), out=file))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (CalibrateMarkerOptions(ids=(50,)), "within 0..49"),
        (CalibrateMarkerOptions(ids=(1, 1)), "each once"),
        (CalibrateMarkerOptions(ids=()), "each once"),
        (CalibrateMarkerOptions(dictionary="DICT_9X9"), "is not known"),
        (CalibrateMarkerOptions(ids=(0, 1), gap_m=0.005), "less than a cell"),
        (CalibrateMarkerOptions(out=Path("/nowhere/marker.svg")), "cannot write"),
    ],
    ids=["no such id", "twice", "none", "dictionary", "gap", "folder"],
)
def test_what_cannot_be_printed_is_refused(
    options: CalibrateMarkerOptions, said: str, tmp_path: Path
) -> None:
    with pytest.raises(PartError, match=said) as caught:
        drawn(options)
    assert caught.value.remedy
