"""The command: from images to a file that a rig can name, or a refusal with every reason."""

from __future__ import annotations

import io
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
import pytest

from drivers.interfaces import PartError
from drivers.rig.calibration_file import read_camera
from hil.camera.pictures import CameraRenderer
from missions.field import rig_list
from missions.field.calibrate.camera import BadViews, calibrate
from missions.field.calibrate.collect import Chooser, Collected, CollectedImage, from_recording
from missions.field.calibrate.run import run
from missions.ground import rig_library
from missions.ground.options.calibrate import (
    CalibrateBoardOptions,
    CalibrateCameraOptions,
    CalibrateOptions,
)
from missions.ground.options.field import RigsOptions
from missions.ground.work import Bars
from missions.trials.pose.calibration import views as calibration_views
from path.calibration.board import Board
from path.calibration.judge import BadSet
from path.camera.model import sensor_of
from path.camera.thinning import Thinning
from tests.path.calibration.rendered import (
    CAMERA,
    CHARUCO,
    CHESSBOARD,
    Held,
    grey,
    photographs,
    poses,
    seen,
)

THINNED = Thinning(3, 5, (1, 2))


def command(options: CalibrateCameraOptions | CalibrateBoardOptions) -> str:
    out = io.StringIO()
    assert run(CalibrateOptions(options), out) == 0
    return out.getvalue()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Photographs of a board."""
    folder = tmp_path_factory.mktemp("views")
    where = list(poses(CHARUCO, Held(), 14, 11))
    for number, color in enumerate(photographs(CHARUCO, where, 4)):
        cv2.imwrite(str(folder / f"view-{number}.png"), color)
    return folder


def test_images_become_a_calibration_and_a_picture(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "deep" / "d1.camera.toml"
    text = command(CalibrateCameraOptions(images=folder, out=out, serial="0815"))
    written = read_camera(out)
    assert written.serial == "0815"
    assert (written.camera.width, written.camera.height) == (640, 480)
    assert written.camera.fx == pytest.approx(CAMERA.fx, rel=1e-3)
    assert written.quality.views == 14
    assert 0.0 < written.standard_errors["fx"] < 1.0
    assert "of views that were left out" in text
    assert cv2.imread(str(out.with_suffix(".png"))) is not None


def film_of(folder: Path, film: Path, views: int) -> Path:
    """Each view is held for two frames, 0.2 s apart."""
    film.mkdir()
    for number in range(views):
        for again in range(2):
            shutil.copy(
                folder / f"view-{number}.png", film / f"{10 + 0.2 * (2 * number + again):.1f}.png"
            )
    return film


def test_views_of_a_recording_are_chosen(folder: Path, tmp_path: Path) -> None:
    film = film_of(folder, tmp_path / "film", 4)
    collected = from_recording(film, CHARUCO, 3, Bars(io.StringIO()))
    assert [look.name for look in collected.looks] == ["10.2.png", "10.6.png", "11.0.png"]
    with pytest.raises(BadViews, match="too_few_views: 3 usable views"):
        calibrate(collected, CHARUCO)


def test_a_rigs_camera_is_calibrated_as_it_runs(folder: Path, tmp_path: Path) -> None:
    """It plays a recording: it ends with it; what it gave is kept, and its serial number known."""
    film_of(folder, tmp_path / "film", 13)
    text = rig_library.whole("sim-rendered")
    rig = tmp_path / "rig.toml"
    rig.write_text(
        text.replace(
            'factory = "hil.camera.rendered:RenderedCamera"\nrate_hz = 50.0',
            'factory = "drivers.recordings.camera:RecordedCamera"\nfile = "film"\npace = "fast"\nserial = "0815"',
            1,
        ),
        "utf-8",
    )
    said = command(CalibrateCameraOptions(rig=str(rig), out=tmp_path / "c.toml"))
    written = read_camera(tmp_path / "c.toml")
    assert written.quality.views == 13
    assert written.camera.fx == pytest.approx(CAMERA.fx, rel=1e-3)
    assert written.serial == "0815"
    assert len(list((tmp_path / "c").glob("view-*.png"))) == 13
    assert "view 13/40" in said


@pytest.mark.parametrize("role", ["sender", "receiver"])
def test_a_new_rigs_camera_is_calibrated_as_the_rigs_own_comment_says(
    folder: Path, tmp_path: Path, role: Literal["sender", "receiver"]
) -> None:
    """Nothing else of the rig is measured by then, and the calibrations that it names are not made
    yet.
    """
    film_of(folder, tmp_path / "film", 13)
    rig = tmp_path / "my-rig.toml"
    assert rig_list.run(RigsOptions(new=str(rig)), io.StringIO()) == 0
    command_line = (
        rig.read_text("utf-8")
        .split("`path-handoff calibrate camera --rig THIS-FILE ", 1)[1]
        .split("`")[0]
    )
    assert command_line == "--role sender --out d1.camera.toml"
    camera = 'factory = "drivers.recordings.camera:RecordedCamera"\nfile = "film"\npace = "fast"'
    real = 'factory = "drivers.realsense.camera:RealSense"\nfps = 30'
    rig.write_text(rig.read_text("utf-8").replace(real, camera), "utf-8")
    out = tmp_path / ("d1.camera.toml" if role == "sender" else "d2.camera.toml")
    command(CalibrateCameraOptions(rig=str(rig), role=role, size="640x480", out=out))
    assert read_camera(out).camera.fx == pytest.approx(CAMERA.fx, rel=1e-3)


def test_a_new_rigs_film_of_another_size_than_was_said_is_refused_with_both(
    folder: Path, tmp_path: Path
) -> None:
    film_of(folder, tmp_path / "film", 2)
    text = 'like = "sim-rendered"\n[sender.camera]\ncalibration = "d1.camera.toml"\n[sender.perception.camera]\n'
    text += 'factory = "drivers.recordings.camera:RecordedCamera"\nfile = "film"\n'
    (tmp_path / "rig.toml").write_text(text, "utf-8")
    with pytest.raises(PartError, match=r"1280x720 px but the frames are 640x480"):
        command(
            CalibrateCameraOptions(rig=str(tmp_path / "rig.toml"), out=tmp_path / "d1.camera.toml")
        )


@pytest.mark.parametrize(
    "size", ["1280", "1280x", "axb", "0x0", "1280x-720", "99999x720", "1280*720", ""]
)
def test_a_size_that_is_none_is_refused(tmp_path: Path, size: str) -> None:
    with pytest.raises(PartError, match="--size"):
        command(CalibrateCameraOptions(rig="sim", size=size, out=tmp_path / "c.toml"))


def collected(held: Held, count: int, **change: float) -> Collected:
    rng = np.random.default_rng(1)
    views = [
        replace(seen(CHARUCO, pose, 0.05, rng), **change) for pose in poses(CHARUCO, held, count, 1)
    ]
    return Collected(
        [CollectedImage(f"{number}.png", (640, 480), view) for number, view in enumerate(views)]
    )


def graded(views: Collected, board: Board = CHARUCO) -> tuple[set[BadSet], str]:
    """Returns what is said of a set that is not good, and its grade."""
    done = calibrate(views, board)
    assert all(fault.fix for fault in done.faults)
    return {fault.reason for fault in done.faults}, done.grade


def refused(views: Collected, board: Board = CHARUCO) -> tuple[set[BadSet], str]:
    with pytest.raises(BadViews) as caught:
        calibrate(views, board)
    assert caught.value.remedy
    return {fault.reason for fault in caught.value.faults}, str(caught.value)


def test_pixels_that_a_camera_leaves_out_are_in_its_calibration(tmp_path: Path) -> None:
    """The sensor's images are drawn, and three of five rows and columns kept."""
    columns, rows = (
        THINNED.sensor_pixels(n, axis) for axis, n in enumerate((CAMERA.width, CAMERA.height))
    )
    where = list(poses(CHARUCO, Held(), 8, 3))
    shots = calibration_views.photographs(
        CameraRenderer, sensor_of(replace(CAMERA, thinning=THINNED)), CHARUCO, where, 4
    )
    for number, color in enumerate(shots):
        cv2.imwrite(str(tmp_path / f"view-{number}.png"), color[np.ix_(rows, columns)])
    out = tmp_path / "out" / "d1.camera.toml"
    text = command(CalibrateCameraOptions(images=tmp_path, out=out))
    written = read_camera(out)
    assert written.camera.model().thinning == THINNED
    assert "3 of 5 rows and columns" in text
    assert "uneven_pixels" not in written.weak
    assert written.camera.fx == pytest.approx(CAMERA.fx, rel=2e-3)


def test_images_of_two_sizes_are_refused_with_both() -> None:
    views = collected(Held(), 16)
    views.looks[3] = replace(views.looks[3], size=(1280, 720))
    reasons, text = refused(views)
    assert reasons == {BadSet.MIXED_SIZES}
    assert "15 of 640x480 px, 1 of 1280x720 px" in text


def test_blurred_views_are_left_out_and_named_when_too_few_are_left() -> None:
    views = collected(Held(), 16)
    for number in (2, 5, 6, 7, 9):
        look = views.looks[number]
        assert look.view is not None
        views.looks[number] = replace(look, view=replace(look.view, blur_px=2.4))
    assert len(calibrate(Collected(views.looks + collected(Held(), 20).looks), CHARUCO).looks) == 31
    done = calibrate(views, CHARUCO)
    assert {fault.reason for fault in done.faults} == {BadSet.TOO_FEW_VIEWS, BadSet.BLURRED}
    assert done.grade == "fair"
    assert any("5 views are blurred, such as 2.png" in fault.found for fault in done.faults)


def test_a_weak_set_gives_a_weak_calibration_that_states_its_errors() -> None:
    views = collected(Held((1.0, 1.05), (5.0, 15.0), 0.05), 9)
    reasons, grade = graded(views)
    assert {BadSet.TOO_FEW_VIEWS, BadSet.CLUSTERED, BadSet.NO_TILT, BadSet.ONE_DISTANCE} <= reasons
    assert grade in ("fair", "weak")
    solution = calibrate(views, CHARUCO).solution
    for k, true in enumerate((CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy)):
        assert abs(solution.values[k] - true) < 3.0 * solution.sigmas[k]
    assert min(solution.sigmas[:2]) >= 0.7 * abs(solution.values[0] - solution.values[1])


def test_grade_and_reasons_are_in_the_file_and_said(folder: Path, tmp_path: Path) -> None:
    few = tmp_path / "few"
    few.mkdir()
    for file in sorted(folder.glob("*.png"))[:7]:
        shutil.copy(file, few)
    text = command(CalibrateCameraOptions(images=few, out=tmp_path / "weak.toml"))
    written = read_camera(tmp_path / "weak.toml")
    assert written.grade in ("fair", "weak")
    assert "too_few_views" in written.weak
    assert f"grade: {written.grade}" in text
    assert "next: take more" in text


def test_a_board_of_the_old_pattern_is_found_out(tmp_path: Path) -> None:
    old = Board("charuco", 10, 8, 0.030, 0.0225, "DICT_4X4_50", legacy=True)
    (tmp_path / "views").mkdir()
    for number, color in enumerate(photographs(old, list(poses(old, Held(), 6, 5)), 4)):
        cv2.imwrite(str(tmp_path / "views" / f"{number}.png"), color)
    options = CalibrateCameraOptions(
        images=tmp_path / "views", out=tmp_path / "old.toml", squares="10x8"
    )
    text = command(options)
    assert "tried as ChArUco, 10x8 squares of 30 mm, DICT_4X4_50, old pattern" in text
    assert "old pattern" in read_camera(tmp_path / "old.toml").board
    assert read_camera(tmp_path / "old.toml").camera.fx == pytest.approx(CAMERA.fx, rel=5e-3)


def test_every_reason_is_given_at_once() -> None:
    reasons, text = refused(collected(Held((1.0, 1.05), (0.0, 2.0), 0.05), 9))
    assert {BadSet.TOO_FEW_VIEWS, BadSet.CLUSTERED, BadSet.NO_TILT, BadSet.ONE_DISTANCE} <= reasons
    assert "none in the top left" in text


@pytest.mark.parametrize(
    ("shown", "named", "words"),
    [
        (CHARUCO, replace(CHARUCO, columns=8, rows=6), "do not lie as on this board"),
        (CHARUCO, CHESSBOARD, "there are .* markers of DICT_4X4_50"),
        (CHESSBOARD, replace(CHESSBOARD, columns=7), "a chessboard of about"),
    ],
)
def test_another_board_than_named_is_told_by_what_is_there(
    shown: Board, named: Board, words: str
) -> None:
    pose = next(poses(shown, Held((0.6, 0.6), (5.0, 5.0), 0.0), 1, 0))
    image = grey(next(photographs(shown, [pose], 0)))
    views = Collected()
    views.add("one.png", image, None)
    with pytest.raises(BadViews, match=words) as caught:
        calibrate(views, named)
    assert caught.value.faults[0].reason is BadSet.NO_BOARD


def test_a_board_is_told_by_most_of_the_images_that_show_it() -> None:
    """The first one shows a part of it only."""
    shown = Board("chessboard", 9, 7, 0.030)
    held = Held((0.6, 0.7), (5.0, 10.0), 0.05)
    images = [grey(color) for color in photographs(shown, list(poses(shown, held, 3, 2)), 0)]
    views = Collected()
    for number, image in enumerate([np.ascontiguousarray(images[0][:, :330]), *images]):
        views.add(f"{number}.png", image, None)
    views.looks.pop(0)
    with pytest.raises(BadViews, match="a chessboard of about 9x7 squares"):
        calibrate(views, replace(shown, columns=10, rows=8))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (CalibrateCameraOptions(), "one of --images, --video and --rig, found none"),
        (CalibrateCameraOptions(images=Path("a"), video=Path("b")), "found images, video"),
        (CalibrateCameraOptions(images=Path("no-such-folder")), "no images in it"),
        (CalibrateCameraOptions(video=Path("no-such.mp4")), "there is no such file"),
        (CalibrateCameraOptions(images=Path(), squares="10"), "is no COLUMNSxROWS"),
        (CalibrateCameraOptions(images=Path(), square_m=0.01), "marker_m"),
        (CalibrateCameraOptions(rig="sim"), "it has no camera of its own"),
        (CalibrateCameraOptions(rig="sim-rendered"), "needs the simulated world"),
    ],
)
def test_what_is_asked_wrongly_is_said(options: CalibrateCameraOptions, words: str) -> None:
    with pytest.raises(PartError, match=words):
        run(CalibrateOptions(options), io.StringIO())


def test_only_still_and_different_views_are_chosen() -> None:
    where = list(poses(CHARUCO, Held(reach=0.1), 3, 2))
    a, b, c = photographs(CHARUCO, where, 1)
    chooser = Chooser(CHARUCO, 2)
    taken = [chooser.offer(grey(color)) is not None for color in (a, b, b, b, c, a, a, c)]
    assert taken == [False, False, True, False, False, False, True, False]
    assert chooser.done


def test_a_board_can_be_drawn_and_found_again(tmp_path: Path) -> None:
    file = tmp_path / "board.png"
    text = command(CalibrateBoardOptions(out=file, dpi=150))
    picture = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
    assert picture is not None
    assert "DICT_4X4_50" in text
    _, ids, _, _ = cv2.aruco.CharucoDetector(
        cv2.aruco.CharucoBoard(
            (10, 7), 0.03, 0.0225, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
        )
    ).detectBoard(picture)
    assert len(ids) == 54
    with pytest.raises(PartError, match="--dpi 100000"):
        run(CalibrateOptions(CalibrateBoardOptions(out=file, dpi=100000)), io.StringIO())
