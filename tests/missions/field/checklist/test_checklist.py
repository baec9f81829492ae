"""One page of paper: this rig's numbers, and a marker that hangs as it is drawn."""

from __future__ import annotations

import math
import re
import shutil
import subprocess
from io import StringIO
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.rig.mounts import MarkerMount
from missions.field.checklist.command import run
from missions.field.checklist.drawings import faces, turned
from missions.ground import rig_library
from missions.ground.options.field import ChecklistOptions
from missions.ground.rig_library import mission_of
from path.marker.photometric.texture import dictionary_of

RIGS = ("sitl-field", "sitl-mixed-field", "sitl-tello", "person-indoor")
CHROMIUM = shutil.which("chromium")
BROWSER = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync",
    "--disable-background-networking", "--disable-component-update", "--hide-scrollbars",
)  # fmt: skip
A4_PX = (794, 1123)
MOUNTS = [
    MarkerMount((0.0, 0.0, 0.0), tilt_up_deg, roll_deg, yaw_deg)
    for tilt_up_deg, roll_deg, yaw_deg in (
        (45.0, 0.0, 0.0), (-30.0, 0.0, 0.0), (0.0, 180.0, 0.0), (30.0, 90.0, 0.0), (30.0, -90.0, 0.0),
        (10.0, 20.0, 180.0), (60.0, 0.0, 90.0), (70.0, 95.0, -30.0), (20.0, 250.0 - 360.0, 45.0),
    )
]  # fmt: skip


def page_of(rig: str, folder: Path) -> Path:
    page = folder / f"{rig}.html"
    assert run(ChecklistOptions(rig, out=page), StringIO()) == 0
    return page


@pytest.mark.parametrize("mount", MOUNTS)
def test_the_edge_that_is_named_is_the_highest_one_and_is_drawn_so(mount: MarkerMount) -> None:
    T_b_v = mount.pose()
    middles_v = {
        "upper": (0.0, 1.0), "lower": (0.0, -1.0), "right": (1.0, 0.0), "left": (-1.0, 0.0)
    }  # fmt: skip
    heights = {
        edge: -float(T_b_v.apply(np.array([x, y, 0.0]))[2]) for edge, (x, y) in middles_v.items()
    }
    said = faces(T_b_v)
    assert f"print's {max(heights, key=heights.__getitem__)} edge is on top" in said
    # on paper y goes down, and to turn is clockwise
    angle = turned(T_b_v)
    drawn = {edge: y * math.cos(angle) - x * math.sin(angle) for edge, (x, y) in middles_v.items()}
    steep = math.hypot(heights["upper"], heights["right"])
    assert drawn == pytest.approx({edge: height / steep for edge, height in heights.items()})


@pytest.mark.parametrize(
    ("mount", "said"),
    [
        (MarkerMount((0.0, 0.0, 0.0), 45.0), "It faces backwards, 45° up."),
        (MarkerMount((0.0, 0.0, 0.0), -20.0, yaw_deg=180.0), "It faces forwards, 20° down."),
        (MarkerMount((0.0, 0.0, 0.0), 0.0, yaw_deg=90.0), "It faces to the left."),
        (MarkerMount((0.0, 0.0, 0.0), 90.0), "It faces 90° up. The print's upper edge is towards"),
    ],
)
def test_which_way_the_print_faces_is_said(mount: MarkerMount, said: str) -> None:
    assert faces(mount.pose()).startswith(said)


@pytest.mark.parametrize("rig", RIGS)
def test_the_page_has_this_rigs_numbers_and_needs_nothing_else(tmp_path: Path, rig: str) -> None:
    text = page_of(rig, tmp_path).read_text("utf-8")
    mission = mission_of(rig_library.load(rig))
    heights = (
        f"D1 to {mission.take_off_height_m:g} m, D2 to {mission.receiver_take_off_height_m:g} m"
    )
    assert heights in text
    assert (
        f"{mission.guard.fence_radius_m:g} m round, {mission.guard.fence_height_m:g} m up" in text
    )
    assert f"a flight ends at {100.0 * mission.guard.min_battery:.0f} %" in text
    words = re.sub(r"</?code>", "", text)
    assert f"path-handoff receiver --rig {rig}" in words
    assert not re.search(r"(src|href)=|url\((?!#)|http", text.replace("http://www.w3.org", ""))


def test_of_each_autopilot_it_says_what_its_radio_does(tmp_path: Path) -> None:
    mixed = page_of("sitl-mixed-field", tmp_path).read_text("utf-8")
    tello = page_of("sitl-tello", tmp_path).read_text("utf-8")
    assert "RC_MAP_KILL_SW" in mixed and "RCn_OPTION 31" in mixed and "“mine”" in mixed
    assert "hand from below" in tello and "RC_MAP" not in tello and "“mine”" not in tello


def browser(*words: str) -> None:
    assert CHROMIUM is not None
    subprocess.run([CHROMIUM, *BROWSER, *words], check=True, timeout=120.0, capture_output=True)


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here")
@pytest.mark.parametrize("rig", RIGS)
def test_it_prints_on_one_sheet(tmp_path: Path, rig: str) -> None:
    page = page_of(rig, tmp_path)
    paper = tmp_path / "paper.pdf"
    browser(f"--user-data-dir={tmp_path}/own", f"--print-to-pdf={paper}", page.as_uri())
    assert len(re.findall(rb"/Type\s*/Page\b(?!s)", paper.read_bytes())) == 1


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here")
def test_a_detector_finds_the_marker_on_the_page_turned_as_it_hangs(tmp_path: Path) -> None:
    shown = corners_on(page_of("sitl", tmp_path), tmp_path)
    up = shown[0] - shown[3]
    assert up[1] < -20.0 and abs(up[0]) < 2.0
    text = rig_library.whole("sitl").replace(
        "tilt_up_deg = 45.0", "tilt_up_deg = 45.0\nroll_deg = 90.0"
    )
    rig = tmp_path / "rolled.toml"
    rig.write_text(text, "utf-8")
    page = tmp_path / "rolled.html"
    run(ChecklistOptions(str(rig), out=page), StringIO())
    right = corners_on(page, tmp_path)
    up = right[0] - right[3]
    assert up[0] > 20.0 and abs(up[1]) < 2.0


def corners_on(page: Path, folder: Path) -> NDArray[np.float64]:
    """Return the corners of marker 0 in a picture of the page, px, top left first as printed."""
    picture = folder / f"{page.stem}.png"
    size = f"--window-size={A4_PX[0]},{A4_PX[1]}"
    browser(f"--user-data-dir={folder}/own", size, f"--screenshot={picture}", page.as_uri())
    image = cv2.imread(str(picture), cv2.IMREAD_GRAYSCALE)
    assert image is not None
    corners, ids, _ = cv2.aruco.ArucoDetector(dictionary_of("DICT_4X4_50")).detectMarkers(image)
    assert ids.ravel().tolist() == [0]
    return np.asarray(corners[0][0], np.float64)
