"""The command: from images to a file that a rig can name, or a refusal with every reason."""

from __future__ import annotations

import io
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from drivers.interfaces import PartError
from drivers.rig.calibration_file import read_camera
from missions.calibrate.camera import BadViews, calibrate
from missions.calibrate.collect import Chooser, Collected, Look, from_recording
from missions.calibrate.run import run
from missions.options import CalibrateBoardOptions, CalibrateCameraOptions, CalibrateOptions
from missions.rig_list import FOLDER
from missions.work import Bars
from path.calibration.board import Board
from path.calibration.judge import BadSet
from tests.path.calibration.rendered import CAMERA, CHARUCO, CHESSBOARD, Held, grey, photographs, poses, seen


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
            shutil.copy(folder / f"view-{number}.png", film / f"{10 + 0.2 * (2 * number + again):.1f}.png")
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
    text = (FOLDER / "sim-rendered.toml").read_text("utf-8")
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


def collected(held: Held, count: int, **change: float) -> Collected:
    rng = np.random.default_rng(1)
    views = [replace(seen(CHARUCO, pose, 0.05, rng), **change) for pose in poses(CHARUCO, held, count, 1)]
    return Collected([Look(f"{number}.png", (640, 480), view) for number, view in enumerate(views)])


def refused(views: Collected, board: Board = CHARUCO) -> tuple[set[BadSet], str]:
    with pytest.raises(BadViews) as caught:
        calibrate(views, board)
    assert caught.value.remedy
    return {fault.reason for fault in caught.value.faults}, str(caught.value)


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
    reasons, text = refused(views)
    assert reasons == {BadSet.TOO_FEW_VIEWS, BadSet.BLURRED}
    assert "5 views are blurred, such as 2.png" in text


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
def test_another_board_than_named_is_told_by_what_is_there(shown: Board, named: Board, words: str) -> None:
    pose = next(poses(shown, Held((0.6, 0.6), (5.0, 5.0), 0.0), 1, 0))
    image = grey(next(photographs(shown, [pose], 0)))
    views = Collected([Look("one.png", (640, 480), None)], image)
    with pytest.raises(BadViews, match=words) as caught:
        calibrate(views, named)
    assert caught.value.faults[0].reason is BadSet.NO_BOARD


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
        (CalibrateCameraOptions(rig="sim-rendered"), "needs a simulated world"),
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
        cv2.aruco.CharucoBoard((10, 7), 0.03, 0.0225, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50))
    ).detectBoard(picture)
    assert len(ids) == 54
    with pytest.raises(PartError, match="--dpi 100000"):
        run(CalibrateOptions(CalibrateBoardOptions(out=file, dpi=100000)), io.StringIO())
