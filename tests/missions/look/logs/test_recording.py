"""A RealSense recording of whoever made it, written out as images that films are read from."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from drivers.interfaces import PartError
from drivers.log.mcap_log import McapLog
from drivers.realsense import recorded
from drivers.realsense.sdk import RealSenseDevice, Streams
from drivers.recordings.recording import RecordingError, RecordingOptions, open_recording
from drivers.rig.calibration_file import read_camera
from missions.ground.options.runs import ExportOptions
from missions.look.logs.export import run
from tests.drivers.realsense.other_cameras import CameraKind, OtherCamera
from tests.drivers.realsense.software_d415 import COLOR, DEPTH, DEPTH_MM, FPS, Feed

FRAMES = 40
STEP_NS = 1_000_000_000 // FPS
BEGIN_NS = 5_000_000_000


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Colour is filled with the frame's number, depth is a wall; frame 7 has no depth."""
    file, feed = tmp_path_factory.mktemp("film") / "d1.db3", Feed()
    streams = Streams((COLOR.width, COLOR.height), (DEPTH.width, DEPTH.height), FPS)
    device = RealSenseDevice(feed.open(), streams, file)
    for number in range(1, FRAMES + 1):
        feed.give(BEGIN_NS + number * STEP_NS, depth=number != 7)
        for _ in range(1 + (number != 7)):
            assert device.next(20.0) is not None
    device.close()
    feed.close()
    return file


def export(film: Path, out: Path, **options: Any) -> Path:
    assert run(ExportOptions(film, out=out, **options)) == 0
    return out


def test_every_frame_with_depth_is_written_once_with_its_stamp(
    film: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also while frames are taken more slowly than they are read: playback waits."""
    monkeypatch.setattr(recorded, "WAITING", 1)
    out = export(film, tmp_path / "d1")
    assert f"{FRAMES - 1} frames with depth" in capsys.readouterr().out
    frames = list(open_recording(out, RecordingOptions(depth=out / "depth")).frames())
    numbers = [n for n in range(1, FRAMES + 1) if n != 7]
    loaded = [frame.load() for frame in frames]
    assert [int(each.color[0, 0, 0]) for each in loaded] == numbers
    assert np.diff([frame.stamp_ns for frame in frames]) == pytest.approx(
        np.diff(numbers) * STEP_NS, abs=2_000_000
    )
    for each in loaded:
        assert each.depth_mm is not None
        seen = each.depth_mm[each.depth_mm > 0]
        assert seen.size > 0.5 * each.depth_mm.size
        assert np.median(seen) == pytest.approx(DEPTH_MM, abs=2)
    calibration = read_camera(tmp_path / "d1.camera.toml")
    assert calibration.camera.distortion == pytest.approx(COLOR.distortion, abs=1e-6)
    assert (calibration.camera.fx, calibration.camera.cy) == (COLOR.fx, COLOR.cy)
    assert calibration.serial


def measured(file: Path) -> int:
    """Pixels that have a depth."""
    depth_mm = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    assert depth_mm is not None
    return int((depth_mm > 0).sum())


def test_a_calibration_of_ones_own_is_taken_instead(film: Path, tmp_path: Path) -> None:
    export(film, tmp_path / "a")
    own = tmp_path / "own.toml"
    own.write_text((tmp_path / "a.camera.toml").read_text().replace("fx = 92.0", "fx = 60.0"))
    export(film, tmp_path / "b", calibration=own)
    assert not (tmp_path / "b.camera.toml").exists()
    wide, narrow = (measured(tmp_path / name / "depth" / "000001.png") for name in ("a", "b"))
    assert narrow < 0.9 * wide  # the same wall falls on fewer columns of a wider lens


@pytest.mark.parametrize(
    ("name", "options", "said"),
    [
        ("none.db3", {}, "no such file"),
        ("d1.db3", {"tum": True}, "of a run's logs"),
        ("d1.db3", {"out": Path("/usr")}, "is not empty"),
        (".", {"tum": True, "calibration": Path("own.toml")}, "of a RealSense recording"),
        ("a.toml", {"tum": True}, "is no folder"),
    ],
    ids=["no file", "tum", "not empty", "calibration of a run", "no folder"],
)
def test_what_cannot_be_written_out_is_refused(
    film: Path, name: str, options: dict[str, Any], said: str
) -> None:
    with pytest.raises(PartError, match=said) as caught:
        run(ExportOptions(film.parent / name, **options))
    assert caught.value.remedy


def test_a_file_that_is_none_is_refused(tmp_path: Path) -> None:
    with McapLog(tmp_path / "log.mcap") as log:
        log.write("/phase", 1, {})
    (tmp_path / "log.mcap").rename(tmp_path / "log.db3")
    with pytest.raises(PartError, match=r"log.db3 cannot be played"):
        run(ExportOptions(tmp_path / "log.db3"))


def test_a_film_that_is_one_names_the_command(film: Path) -> None:
    with pytest.raises(RecordingError, match="RealSense recording") as caught:
        open_recording(film)
    assert f"path-handoff export {film}" in caught.value.remedy


def test_what_was_refused_leaves_nothing_that_a_second_try_meets(tmp_path: Path) -> None:
    kind = CameraKind(lens="ftheta", coefficients=(0.1, 0.0, 0.0, 0.0, 0.0))
    file = OtherCamera(kind).record(tmp_path / "d1.db3")
    with pytest.raises(PartError, match="ftheta"):
        run(ExportOptions(file))
    assert sorted(tmp_path.iterdir()) == [file]
    OtherCamera(CameraKind()).record(tmp_path / "d2.db3")
    run(ExportOptions(tmp_path / "d2.db3"))
    assert run(ExportOptions(file, calibration=tmp_path / "d2.camera.toml")) == 0
    assert (tmp_path / "d1" / "000001.png").is_file()


def test_a_calibration_of_ones_own_is_not_written_over(tmp_path: Path) -> None:
    file = OtherCamera(CameraKind()).record(tmp_path / "d1.db3")
    export(file, tmp_path / "first")
    own = (
        (tmp_path / "first.camera.toml")
        .read_text()
        .replace("the maker's calibration in d1.db3", "views")
    )
    (tmp_path / "d1.camera.toml").write_text(own)
    with pytest.raises(PartError, match=r"d1.camera.toml is there, and is not the maker's"):
        run(ExportOptions(file))
    assert (tmp_path / "d1.camera.toml").read_text() == own
    assert not (tmp_path / "d1").exists()


def test_a_lens_of_another_kind_is_told_of_with_how_far_off_it_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kind = CameraKind("D455", coefficients=(-0.055, 0.066, 0.0003, 0.0007, -0.0215))
    file = OtherCamera(kind).record(tmp_path / "d1.db3")
    export(file, tmp_path / "d1")
    assert "its lens as Brown-Conrady, off by 0.000 px at most" in capsys.readouterr().out
    assert read_camera(tmp_path / "d1.camera.toml").camera.distortion[0] == pytest.approx(
        0.056, abs=0.002
    )
