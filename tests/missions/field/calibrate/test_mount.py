"""The place of D1's camera relative to its marker: from pairs of rendered images, and from a tape
measure.
"""

from __future__ import annotations

import io
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import pytest

from drivers.interfaces import PartError
from drivers.rig.calibration_file import (
    CalibrationError,
    CameraCalibration,
    CameraTable,
    Quality,
    read_mount,
    write_calibration,
)
from drivers.rig.file import load_rig
from drivers.rig.parts import Rig
from flight.harness.renderer import RenderedInstant, RendererSetup
from hil.camera.pictures import CameraRenderer
from missions.field.calibrate.mount import solve_pairs
from missions.field.calibrate.run import run
from missions.ground.options.calibrate import CalibrateMountOptions, CalibrateOptions
from missions.ground.rigs import FOLDER
from path.calibration.board import Board, find_board
from path.calibration.mount import MountPair
from path.camera.model import CameraModel
from path.geometry.rotation import R_from_rpy, angle_between, exp
from path.geometry.transforms import Pose
from path.marker.detect import detect_markers
from path.messages import Role
from tests.path.calibration.rendered import LEVEL, grey, placed

BOARD = Board("charuco", 7, 5, 0.050, 0.035, "DICT_5X5_50")
OTHER = CameraModel(800, 600, 705.0, 706.0, 396.0, 302.0, (0.1, -0.2, 0.0003, -0.0004, 0.08))
NED_TO_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
PAIRS = 10


class Truth(NamedTuple):
    """A moment: D1's body, the board and the other camera in the world."""

    T_w_b: Pose
    T_w_o: Pose
    T_w_c3: Pose


def moment(rig: Rig, rng: np.random.Generator) -> Truth:
    """D1 above ground, the board ahead of it to one side, the other camera behind and above, on
    that side.
    """
    T_w_b = Pose(NED_TO_ENU @ R_from_rpy(*rng.uniform(-0.1, 0.1, 3)), np.array([0.0, 0.0, 1.2]))
    side = rng.choice([-1.0, 1.0])
    middle = 0.5 * BOARD.square_m * np.array([BOARD.columns, BOARD.rows, 0.0])
    towards = rng.uniform(0.0, 2.0 * math.pi)
    R = exp(
        np.array([math.cos(towards), math.sin(towards), 0.0]) * math.radians(rng.uniform(0.0, 20.0))
    )
    at = np.array([side * rng.uniform(0.12, 0.25), rng.uniform(-0.2, -0.05), 1.0]) * rng.uniform(
        0.8, 1.0
    )
    T_w_o = T_w_b @ rig.sender.mount.T_b_c @ Pose(R, at - R @ middle)
    v = (T_w_b @ rig.sender.mount.T_b_v).t
    eye = v + np.array(
        [side * rng.uniform(0.0, 0.35), rng.uniform(-0.45, -0.2), rng.uniform(0.3, 0.55)]
    )
    z = 0.5 * (v + T_w_o.apply(middle)) - eye
    z /= np.linalg.norm(z)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    R_w_c3 = np.column_stack((x, np.cross(z, x), z)) @ exp(
        np.array([0.0, 0.0, rng.uniform(-0.4, 0.4)])
    )
    return Truth(T_w_b, T_w_o, Pose(R_w_c3, eye))


class Views(NamedTuple):
    rig: Rig
    first: Path
    other: Path
    other_camera: Path
    pairs: list[MountPair]


@pytest.fixture(scope="module")
def views(tmp_path_factory: pytest.TempPathFactory) -> Views:
    """Images of both cameras, in two folders."""
    folder = tmp_path_factory.mktemp("mount")
    rig = load_rig("sim-rendered", [FOLDER])
    mount, rng = rig.sender.mount, np.random.default_rng(3)
    of_d1 = CameraRenderer(
        RendererSetup(rig.sender.camera, mount.T_b_c, mount.T_b_v, rig.layout), 1
    )
    of_other = CameraRenderer(RendererSetup(OTHER, LEVEL, mount.T_b_v, rig.layout), 2)
    pairs: list[MountPair] = []
    for number in range(PAIRS):
        truth = moment(rig, rng)
        stage = RenderedInstant(
            {Role.SENDER: truth.T_w_b, Role.RECEIVER: truth.T_w_c3},
            boards=(placed(BOARD, truth.T_w_o),),
        )
        one, three = (
            of_d1.shoot(stage, Role.SENDER, number),
            of_other.shoot(stage, Role.RECEIVER, number),
        )
        for name, color in (("d1", one.color), ("other", three.color)):
            (folder / name).mkdir(exist_ok=True)
            cv2.imwrite(str(folder / name / f"{number}.png"), color)
        board_1, board_3 = find_board(grey(one.color), BOARD), find_board(grey(three.color), BOARD)
        markers = detect_markers(three.color, None, rig.layout, OTHER)
        if board_1 is not None and board_3 is not None and markers:
            pairs.append(MountPair(f"{number}.png", board_1, board_3, tuple(markers)))
    lens = CameraTable.of(OTHER)
    file = folder / "other.toml"
    write_calibration(
        file, CameraCalibration("camera", 1, "", "", "", "", lens, {}, Quality(0.0, 0.0, 0, 0, 0.0))
    )
    return Views(rig, folder / "d1", folder / "other", file, pairs)


def options(views: Views, out: Path, **changes: object) -> CalibrateMountOptions:
    made = CalibrateMountOptions(
        board="charuco",
        squares="7x5",
        square_m=0.050,
        marker_m=0.035,
        dictionary="DICT_5X5_50",
        rig="sim-rendered",
        images=views.first,
        other_images=views.other,
        other_camera=views.other_camera,
        out=out,
    )
    return replace(made, **changes)  # type: ignore[arg-type]


def test_pairs_of_images_give_the_mount_to_a_millimetre_and_a_tenth_of_a_degree(
    views: Views, tmp_path: Path
) -> None:
    out = io.StringIO()
    file = tmp_path / "mount.toml"
    assert run(CalibrateOptions(options(views, file)), out) == 0
    written, true = read_mount(file), views.rig.sender.mount.T_v_c
    error = written.T_v_c.t - true.t
    turned_deg = math.degrees(angle_between(written.T_v_c.R, true.R))
    assert np.linalg.norm(error) < 0.001
    assert turned_deg < 0.1
    assert np.all(np.abs(error) < 4.0 * np.array(written.position_sigma_m))
    assert turned_deg < 4.0 * np.linalg.norm(written.rotation_sigma_deg)
    assert max(written.position_sigma_m) < 0.0015
    assert written.pairs == len(views.pairs)
    assert "[sender.mount.marker] calibration" in out.getvalue()


def moved(pair: MountPair) -> MountPair:
    """The board was pushed between the two images."""
    return replace(
        pair,
        board_1=replace(pair.board_1, corners_px=pair.board_1.corners_px + np.array([25.0, 0.0])),
    )


def test_a_pair_in_which_something_moved_is_left_out(views: Views) -> None:
    pairs = [*views.pairs[1:], moved(views.pairs[0])]
    solution = solve_pairs(pairs, views.rig, OTHER, BOARD)
    assert {fit.name for fit in solution.pairs} == {pair.name for pair in views.pairs[1:]}
    assert np.linalg.norm(solution.T_v_c1.t - views.rig.sender.mount.T_v_c.t) < 0.0015


def as_it_is(rig: Rig) -> Rig:
    return rig


def wrong_side(rig: Rig) -> Rig:
    marker = replace(rig.layout.markers[0], side_m=0.041)
    return replace(rig, layout=replace(rig.layout, markers=(marker,)))


@pytest.mark.parametrize(
    ("rig", "count", "words"),
    [
        (as_it_is, 4, "4 usable pairs, at least 5"),
        (wrong_side, PAIRS, r"the marker measures 0\.97\d+ times what the rig says"),
    ],
)
def test_pairs_that_are_not_enough_are_refused(
    views: Views, rig: Callable[[Rig], Rig], count: int, words: str
) -> None:
    with pytest.raises(CalibrationError, match=words) as caught:
        solve_pairs(views.pairs[:count], rig(views.rig), OTHER, BOARD)
    assert caught.value.remedy


def test_pairs_that_contradict_each_other_are_refused(views: Views) -> None:
    rng = np.random.default_rng(0)
    shaken = [
        replace(
            pair,
            board_1=replace(
                pair.board_1, corners_px=pair.board_1.corners_px + rng.uniform(-30, 30, 2)
            ),
        )
        for pair in views.pairs
    ]
    with pytest.raises(CalibrationError, match=r"contradict|no mount fits"):
        solve_pairs(shaken, views.rig, OTHER, BOARD)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"rig": ""}, "--rig is missing"),
        ({"board": "chessboard"}, "half a turn"),
        ({"dictionary": "DICT_4X4_50"}, "the board has the marker 0"),
        ({"other_camera": None}, "expected --images, --other-images and --other-camera"),
        ({"other_images": Path("no-such")}, "no images in it"),
    ],
)
def test_what_is_asked_wrongly_is_said(
    views: Views, tmp_path: Path, changes: dict[str, object], words: str
) -> None:
    with pytest.raises(PartError, match=words):
        run(CalibrateOptions(options(views, tmp_path / "m.toml", **changes)), io.StringIO())


def test_images_of_another_size_than_the_calibration_are_refused(
    views: Views, tmp_path: Path
) -> None:
    with pytest.raises(CalibrationError, match="for 800x600 px but the frames are 640x480 px"):
        run(
            CalibrateOptions(options(views, tmp_path / "m.toml", other_images=views.first)),
            io.StringIO(),
        )


TAPE = """
[camera]
position_b_m = [0.10, 0.0, 0.02]
pitch_down_deg = 45.0
[marker]
position_b_m = [-0.18, 0.0, -0.06]
tilt_up_deg = 45.0
[sigma]
position_m = 0.002
angle_deg = 1.0
"""


def test_a_tape_measure_gives_the_mount_of_the_rig_with_its_errors(tmp_path: Path) -> None:
    tape, out, said = tmp_path / "tape.toml", tmp_path / "m.toml", io.StringIO()
    tape.write_text(TAPE, "utf-8")
    assert (
        run(
            CalibrateOptions(CalibrateMountOptions(rig="sim-rendered", measured=tape, out=out)),
            said,
        )
        == 0
    )
    written, true = read_mount(out), load_rig("sim-rendered", [FOLDER]).sender.mount.T_v_c
    assert written.T_v_c.t == pytest.approx(true.t)
    assert pytest.approx(true.R) == written.T_v_c.R
    lever_m = math.radians(1.0) * np.linalg.norm(true.t)
    assert written.position_sigma_m == pytest.approx(
        3 * (math.hypot(0.002, 0.002, lever_m),), rel=1e-3
    )
    assert "mount_sigma_m = " in said.getvalue()
    assert "right way up" not in said.getvalue()
    tape.write_text(TAPE.replace("angle_deg", "angle"), "utf-8")
    with pytest.raises(CalibrationError, match="unknown key 'angle'"):
        run(
            CalibrateOptions(CalibrateMountOptions(rig="sim-rendered", measured=tape, out=out)),
            said,
        )


def test_a_marker_that_hangs_far_from_what_the_rig_says_is_told(tmp_path: Path) -> None:
    tape, out, said = tmp_path / "tape.toml", tmp_path / "m.toml", io.StringIO()
    tape.write_text(TAPE.replace("tilt_up_deg = 45.0", "tilt_up_deg = 90.0"), "utf-8")
    assert (
        run(
            CalibrateOptions(CalibrateMountOptions(rig="sim-rendered", measured=tape, out=out)),
            said,
        )
        == 0
    )
    assert (
        "turned by 45 degrees against the mounts in the rig. Is the plate the right way up?"
        in said.getvalue()
    )


def test_the_mount_that_the_rig_names_may_be_the_one_that_is_made(tmp_path: Path) -> None:
    tape = tmp_path / "tape.toml"
    rig = tmp_path / "rig.toml"
    out = tmp_path / "d1.mount.toml"
    said = io.StringIO()
    tape.write_text(TAPE, "utf-8")
    rig.write_text(
        'like = "sim-rendered"\n[sender.mount.marker]\ncalibration = "d1.mount.toml"\n', "utf-8"
    )
    assert (
        run(CalibrateOptions(CalibrateMountOptions(rig=str(rig), measured=tape, out=out)), said)
        == 0
    )
    assert "right way up" not in said.getvalue()  # the rig says nothing of how it hangs
    true = load_rig("sim-rendered", [FOLDER]).sender.mount.T_v_c
    assert read_mount(out).T_v_c.t == pytest.approx(true.t)
