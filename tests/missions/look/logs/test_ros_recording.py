"""Bags of ROS: their images are written out by `export`, and everything else says that this is what
to do.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.interfaces import CameraError, PartError
from drivers.realsense.sources import RecordingSource
from drivers.recordings.recording import RecordingError, RecordingOptions, open_recording
from drivers.recordings.ros_bag import ros_bag_at
from drivers.rig.calibration_file import read_camera
from missions.ground.options.runs import ExportOptions
from missions.look.logs.export import run
from tests.drivers.recordings.ros_bags import (
    BEGIN_NS,
    COLOR_BGR,
    DEPTH_MM,
    FORMS,
    FRAMES,
    RAW,
    STEP_NS,
    BagKind,
    Form,
    written,
)

KINDS = {
    "rgb8 and 16UC1": BagKind(),
    "bgra8, metres": BagKind("bgra8", "32FC1"),
    "jpeg, compressed depth": BagKind(
        "png", "compressedDepth", color_topic="/camera/color/image_raw/compressed"
    ),
    "rows with an end, large bytes first": BagKind("rgba8", "mono16", padding=8, big_endian=True),
    "depth 5 ms later": BagKind(late_ns=5_000_000),
    "raw depth of the very same camera": BagKind(depth_topic=RAW),
}


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
def test_colour_and_depth_of_a_bag_become_images_that_films_are_read_from(
    tmp_path: Path, form: Form, kind: BagKind
) -> None:
    file = written(tmp_path, form, kind)
    out = tmp_path / "out"
    assert run(ExportOptions(file, out=out)) == 0
    frames = list(open_recording(out, RecordingOptions(depth=out / "depth")).frames())
    assert [frame.stamp_ns for frame in frames] == [BEGIN_NS + k * STEP_NS for k in range(FRAMES)]
    for frame in frames:
        loaded = frame.load()
        assert np.abs(loaded.color.reshape(-1, 3).astype(int) - COLOR_BGR).max() <= 3
        assert loaded.depth_mm is not None
        assert np.unique(loaded.depth_mm[2:]).tolist() == [DEPTH_MM]
        assert not loaded.depth_mm[:2].any()
    camera = read_camera(tmp_path / "out.camera.toml").camera
    assert camera.distortion == pytest.approx(kind.coefficients, abs=1e-6)
    assert camera.fx == pytest.approx(30.0)


@pytest.mark.parametrize(
    ("model", "coefficients"),
    [
        ("rational_polynomial", (0.4, -2.4, 0.0003, 0.0007, 1.5, 0.3, -2.2, 1.4)),
        ("equidistant", (0.01, 0.0, 0.0, 0.0)),
        ("rational_polynomial", (0.0,) * 8),
        ("", ()),
    ],
)
def test_lenses_of_ros_are_read_as_what_they_are(
    tmp_path: Path, model: str, coefficients: tuple[float, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    file = written(tmp_path, "db3", BagKind(model=model, coefficients=coefficients))
    assert run(ExportOptions(file, out=tmp_path / "out")) == 0
    assert ("its lens as Brown-Conrady" in capsys.readouterr().out) == any(coefficients)
    assert any(read_camera(tmp_path / "out.camera.toml").camera.distortion) == any(coefficients)


def test_a_folder_of_ros_2_is_written_out_into_itself(tmp_path: Path) -> None:
    file = written(tmp_path, "mcap", BagKind())
    assert run(ExportOptions(file.parent)) == 0
    assert len(list((file.parent / "export" / "depth").glob("*.png"))) == FRAMES


def test_a_bag_that_does_not_say_its_lens_gives_its_images_all_the_same(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert (
        run(ExportOptions(written(tmp_path, "ros1", BagKind(model=None)), out=tmp_path / "out"))
        == 0
    )
    assert "it does not say what lens it has: calibrate the camera" in capsys.readouterr().out
    assert not (tmp_path / "out.camera.toml").exists()
    assert len(list((tmp_path / "out").glob("*.png"))) == FRAMES


REFUSED: dict[str, tuple[BagKind, str]] = {
    "depth of another camera": (
        BagKind(depth_topic=RAW, depth_focal_px=33.0),
        "does not say where that camera is",
    ),
    "millimetres as metres": (BagKind(depth="32FC1", unit_m=1.0), "1500 .*: these are no metres"),
    "stamps that stand still": (
        BagKind(step_ns=0),
        "of 6 images of /camera/color/image_raw 5 are stamped no later than the one before",
    ),
    "stamps that go back": (BagKind(step_ns=-STEP_NS), "5 are stamped no later"),
    "a camera_info of other images": (
        BagKind(info_width=640),
        "images of 24x16 px with a camera_info of 640x16 px",
    ),
    "no image that is whole": (
        BagKind("png", color_topic="/camera/color/image_raw/compressed", torn=tuple(range(FRAMES))),
        "compressed as rgb8; png cannot be read",
    ),
    "no colour": (BagKind(color_topic="/camera/infra1/image_raw"), "has no colour to be read"),
    "depth of another size": (
        BagKind(depth_height=8),
        "depth of 24x8 px for colour of 24x16 px: it is not registered",
    ),
    "another encoding": (BagKind(color="8SC3"), "colour is encoded as 8SC3"),
    "depth in bytes": (BagKind(depth="8UC1"), "depth is encoded as 8UC1"),
    "another lens": (BagKind(model="ftheta"), "a lens of a kind that is not known: ftheta"),
    "never together": (BagKind(late_ns=17_000_000_000), "were never taken together"),
}


@pytest.mark.parametrize(("kind", "said"), REFUSED.values(), ids=REFUSED)
def test_what_a_bag_has_not_is_refused_by_name_and_leaves_nothing(
    tmp_path: Path, kind: BagKind, said: str
) -> None:
    file = written(tmp_path, "db3", kind)
    with pytest.raises(PartError, match=said) as caught:
        run(ExportOptions(file, out=tmp_path / "out"))
    assert caught.value.remedy
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("topic", ["/image_raw", "/cam0/image_raw", "/camera/color/image_raw"])
@pytest.mark.parametrize("form", FORMS)
def test_a_bag_of_colour_alone_is_read_and_says_so(
    tmp_path: Path, form: Form, topic: str, capsys: pytest.CaptureFixture[str]
) -> None:
    file = written(tmp_path, form, BagKind(depth_topic=None, color_topic=topic))
    assert run(ExportOptions(file, out=tmp_path / "out")) == 0
    assert f"{FRAMES} frames without depth" in capsys.readouterr().out
    assert not (tmp_path / "out" / "depth").exists()
    assert len(list(open_recording(tmp_path / "out").frames())) == FRAMES


def test_torn_images_of_a_bag_are_left_out_and_counted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kind = BagKind("png", color_topic="/camera/color/image_raw/compressed", torn=(0, 3))
    assert run(ExportOptions(written(tmp_path, "mcap", kind), out=tmp_path / "out")) == 0
    assert "4 frames with depth, 2 that were torn left out" in capsys.readouterr().out
    stamps = [frame.stamp_ns for frame in open_recording(tmp_path / "out").frames()]
    assert stamps == [BEGIN_NS + k * STEP_NS for k in (1, 2, 4, 5)]


@pytest.mark.parametrize("gone", ["metadata.yaml", "bag.db3"])
def test_a_folder_of_ros_2_that_is_not_whole_says_what_is_missing(
    tmp_path: Path, gone: str
) -> None:
    folder = written(tmp_path, "db3", BagKind()).parent
    (folder / gone).unlink()
    with pytest.raises(PartError, match="a bag of ROS 2 that is not whole") as caught:
        run(ExportOptions(folder))
    assert "ros2 bag reindex" in caught.value.remedy


@pytest.mark.parametrize("form", FORMS)
def test_whoever_plays_recordings_says_that_a_bag_of_ros_is_written_out_first(
    tmp_path: Path, form: Form
) -> None:
    file = written(tmp_path, form, BagKind())
    places: Sequence[Path] = (file,) if form == "ros1" else (file, file.parent)
    number = 1 if form == "ros1" else 2
    for place in places:
        with pytest.raises(
            RecordingError, match=rf"is a ROS {number} bag.* with /camera/color/image_raw"
        ) as caught:
            open_recording(place)
        assert f"path-handoff export {place}" in caught.value.remedy
    if form != "mcap":
        with pytest.raises(CameraError, match=rf"is a ROS {number} bag"):
            RecordingSource(file).open()


def test_without_the_extra_a_bag_is_named_with_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = written(tmp_path, "ros1", BagKind())
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(PartError, match="is a ROS 1 bag with /camera/color/image_raw") as caught:
        run(ExportOptions(file))
    assert "the extra `ros`" in caught.value.remedy


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_a_bag_that_was_cut_is_refused_by_name_or_read_as_far_as_it_goes(
    tmp_path: Path, form: Form, share: float
) -> None:
    file = written(tmp_path, form, BagKind())
    content = file.read_bytes()
    file.write_bytes(content[: int(share * len(content))])
    try:
        assert run(ExportOptions(file, out=tmp_path / "out")) == 0
    except PartError as error:
        assert str(file) in str(error)
        assert error.remedy


def test_a_bag_that_is_compressed_as_a_whole_says_what_unpacks_it(tmp_path: Path) -> None:
    (tmp_path / "bag.db3.zstd").write_bytes(b"\x28\xb5\x2f\xfd" + bytes(20))
    found = ros_bag_at(tmp_path / "bag.db3.zstd")
    assert found is not None and "zstd -d unpacks it" in found.text


@pytest.mark.parametrize("options", [{"tum": True}, {"csv": True}])
def test_tables_of_a_run_are_not_asked_of_a_bag(tmp_path: Path, options: dict[str, Any]) -> None:
    with pytest.raises(PartError, match="are of a run's logs"):
        run(ExportOptions(written(tmp_path, "mcap", BagKind()), **options))
