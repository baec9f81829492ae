"""Recordings: video files, image folders and logs, each through a real file; what cannot be played
is refused.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.log.mcap_log import McapLog
from drivers.recordings.recording import (
    RecordedFrame,
    RecordingError,
    RecordingOptions,
    open_recording,
)
from tests.written_logs import until_written

WIDTH, HEIGHT = 64, 48
GREYS = (20, 60, 100, 140, 180)


def image(grey: int, width: int = WIDTH, height: int = HEIGHT) -> NDArray[np.uint8]:
    return np.full((height, width, 3), grey, np.uint8)


def write_video(
    file: Path, greys: Sequence[int] = GREYS, stamps_ms: Sequence[int] | None = None
) -> None:
    """H.264 with the given presentation times, 40 ms apart by default."""
    with av.open(str(file), "w") as container:
        stream: Any = container.add_stream("libx264", rate=25)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        stream.time_base = Fraction(1, 1000)
        stream.codec_context.time_base = Fraction(1, 1000)
        for number, grey in enumerate(greys):
            frame = av.VideoFrame.from_ndarray(image(grey), format="bgr24")
            frame.pts = 40 * number if stamps_ms is None else stamps_ms[number]
            frame.time_base = Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


def write_images(folder: Path, names: Sequence[str], greys: Sequence[int] = GREYS) -> Path:
    folder.mkdir(exist_ok=True)
    for name, grey in zip(names, greys, strict=False):
        cv2.imwrite(str(folder / name), image(grey))
    return folder


def seen_level(color: NDArray[np.uint8]) -> int:
    """Grey level, to the nearest of ``GREYS``: codecs change it a little."""
    return min(GREYS, key=lambda grey: abs(grey - float(color.mean())))


def seen(frames: Sequence[RecordedFrame]) -> list[int]:
    return [seen_level(frame.load().color) for frame in frames]


@pytest.mark.parametrize("suffix", [".mp4", ".mkv"])
def test_a_video_gives_its_frames_with_their_own_stamps(tmp_path: Path, suffix: str) -> None:
    file = tmp_path / f"film{suffix}"
    write_video(file, stamps_ms=(0, 40, 80, 200, 240))
    recording = open_recording(file)
    for _ in range(2):  # as often as it is asked
        frames = list(recording.frames())
        assert [frame.stamp_ns // 1_000_000 for frame in frames] == [0, 40, 80, 200, 240]
        assert seen(frames) == list(GREYS)
        assert frames[0].load().color.shape == (HEIGHT, WIDTH, 3)


def test_a_damaged_video_is_refused_or_ends_with_the_reason(tmp_path: Path) -> None:
    whole = tmp_path / "whole.mp4"
    write_video(whole)
    cut = tmp_path / "cut.mp4"
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    noise = tmp_path / "noise.mp4"
    noise.write_bytes(bytes(range(256)) * 20)
    empty = tmp_path / "empty.mkv"
    empty.write_bytes(b"")
    for file, words in (
        (cut, "no video stream|cannot be read"),
        (noise, "cannot be read"),
        (empty, "cannot be read"),
    ):
        with pytest.raises(RecordingError, match=words) as caught:
            open_recording(file)
        assert file.name in str(caught.value)


def test_a_video_that_breaks_off_gives_the_frames_before(tmp_path: Path) -> None:
    file = tmp_path / "film.mkv"
    write_video(file, GREYS * 20)
    file.write_bytes(file.read_bytes()[: file.stat().st_size * 2 // 3])
    frames = list(open_recording(file).frames())
    assert 20 < len(frames) < 90
    assert seen(frames[:5]) == list(GREYS)


def test_a_sound_file_is_no_video(tmp_path: Path) -> None:
    file = tmp_path / "sound.mkv"
    with av.open(str(file), "w") as container:
        stream: Any = container.add_stream("pcm_s16le", rate=8000, layout="mono")
        frame = av.AudioFrame.from_ndarray(
            np.zeros((1, 160), np.int16), format="s16", layout="mono"
        )
        frame.sample_rate = 8000
        container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    with pytest.raises(RecordingError, match="there is no video stream in it"):
        open_recording(file)


@pytest.mark.parametrize(
    ("names", "steps_ns"),
    [
        (
            ("1700000000000000100.png", "1700000000000000300.png", "1700000000000000200.png"),
            [0, 100, 200],
        ),
        (("12.5.png", "13.75.png", "12.75.png"), [0, 250_000_000, 1_250_000_000]),
    ],
)
def test_names_of_images_can_be_their_stamps(
    tmp_path: Path, names: Sequence[str], steps_ns: list[int]
) -> None:
    frames = list(open_recording(write_images(tmp_path / "images", names)).frames())
    assert [frame.stamp_ns - frames[0].stamp_ns for frame in frames] == steps_ns
    assert seen(frames) == [GREYS[0], GREYS[2], GREYS[1]]


def test_stamps_come_from_a_table_or_a_rate(tmp_path: Path) -> None:
    folder = write_images(tmp_path / "images", ("img2.png", "img10.png", "img1.png"))
    by_rate = open_recording(folder, RecordingOptions(rate_hz=50.0))
    assert by_rate.count == 3
    assert [frame.name for frame in by_rate.frames()] == ["img1.png", "img2.png", "img10.png"]
    assert [frame.stamp_ns for frame in by_rate.frames()] == [0, 20_000_000, 40_000_000]
    (folder / "stamps.csv").write_text(
        "file,stamp_s\nimg10.png,1.5\nimg1.png,1.75\nimg2.png,1.0\n", "utf-8"
    )
    assert [frame.name for frame in open_recording(folder).frames()] == [
        "img2.png",
        "img10.png",
        "img1.png",
    ]
    other = tmp_path / "other.csv"
    other.write_text("file,stamp_ns\nimg10.png,5\nimg1.png,6\nimg2.png,7\n", "utf-8")
    assert [
        f.stamp_ns for f in open_recording(folder, RecordingOptions(stamps=other)).frames()
    ] == [5, 6, 7]


@pytest.mark.parametrize(
    ("table", "words"),
    [
        (None, "the name of a.png is no time, and there is no stamps.csv"),
        ("file,stamp_ns\na.png,1\n", "there is no stamp for b.png"),
        ("file,stamp_ns\na.png,1\nb.png,x\n", "line 3: .* has no file and stamp"),
        ("name,time\na.png,1\n", "line 2: .* has no file and stamp"),
        ("file,stamp_ns\na.png,7\nb.png,7\n", "b.png has the stamp of another image"),
    ],
)
def test_images_without_stamps_are_refused(tmp_path: Path, table: str | None, words: str) -> None:
    folder = write_images(tmp_path / "images", ("a.png", "b.png"))
    if table is not None:
        (folder / "stamps.csv").write_text(table, "utf-8")
    with pytest.raises(RecordingError, match=words):
        open_recording(folder)


def test_depth_beside_the_images_is_in_the_frames(tmp_path: Path) -> None:
    folder, depth = write_images(tmp_path / "images", ("1.0.png", "2.0.png")), tmp_path / "depth"
    depth.mkdir()
    cv2.imwrite(str(depth / "1.0.png"), np.full((HEIGHT, WIDTH), 1234, np.uint16))
    cv2.imwrite(str(depth / "2.0.png"), np.zeros((HEIGHT, WIDTH), np.uint8))
    frames = list(open_recording(folder, RecordingOptions(depth=depth)).frames())
    first = frames[0].load().depth_mm
    assert first is not None
    assert first.dtype == np.uint16
    assert np.all(first == 1234)
    with pytest.raises(RecordingError, match="expected 16-bit depth of 64x48 px, found uint8"):
        frames[1].load()
    (depth / "2.0.png").unlink()
    with pytest.raises(RecordingError, match="there is no depth image"):
        frames[1].load()


def test_an_image_of_another_size_or_none_is_refused_with_its_name(tmp_path: Path) -> None:
    folder = write_images(tmp_path / "images", ("1.0.png", "2.0.png"))
    cv2.imwrite(str(folder / "3.0.png"), image(9, 32, 24))
    (folder / "4.0.png").write_bytes(b"no image")
    first, second, third, fourth = open_recording(folder).frames()
    assert seen((first, second)) == list(GREYS[:2])
    with pytest.raises(
        RecordingError, match=r"3\.0\.png: 32x24 px, the images before it have 64x48 px"
    ):
        third.load()
    with pytest.raises(RecordingError, match=r"4\.0\.png: this is no image"):
        fourth.load()


def write_log(file: Path, topics: Sequence[str]) -> None:
    with McapLog(file) as log:
        fill_log(log, topics)


def fill_log(log: McapLog, topics: Sequence[str]) -> None:
    for number, grey in enumerate(GREYS):
        log.write("/phase", 1000 * number, {"phase": "follow", "note": ""})
        for topic in topics:
            log.image(topic, 1000 * number + 5, image(grey))


def test_the_images_of_a_log_play_again_also_when_it_was_cut_off(tmp_path: Path) -> None:
    file = tmp_path / "sender.mcap"
    write_log(file, ["/image"])
    frames = list(open_recording(file).frames())
    assert [frame.stamp_ns for frame in frames] == [5, 1005, 2005, 3005, 4005]
    assert seen(frames) == list(GREYS)
    with McapLog(file) as log:
        fill_log(log, ["/image"])
        until_written(log)
        killed = file.read_bytes()
    file.write_bytes(killed[: len(killed) * 3 // 4])
    assert 0 < len(list(open_recording(file).frames())) < 5


def test_a_log_without_images_or_with_several_kinds_is_refused_with_what_is_there(
    tmp_path: Path,
) -> None:
    none, two = tmp_path / "none.mcap", tmp_path / "two.mcap"
    write_log(none, [])
    write_log(two, ["/image", "/other"])
    with pytest.raises(RecordingError, match="there are no images in this log"):
        open_recording(none)
    with pytest.raises(RecordingError, match="expected one kind of images, found /image, /other"):
        open_recording(two)
    with pytest.raises(RecordingError, match="expected images at '/left', found /image, /other"):
        open_recording(two, RecordingOptions(topic="/left"))
    assert len(list(open_recording(two, RecordingOptions(topic="/other")).frames())) == 5
    (tmp_path / "text.mcap").write_text("no log")
    with pytest.raises(RecordingError, match="is not an MCAP file"):
        open_recording(tmp_path / "text.mcap")


def test_what_is_no_recording_is_refused(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("x")
    (tmp_path / "empty").mkdir()
    for name, words in (
        ("gone.mp4", "there is no such"),
        ("notes.txt", "kind '.txt'"),
        ("empty", "no frames in it"),
    ):
        with pytest.raises(RecordingError, match=words) as caught:
            open_recording(tmp_path / name)
        assert "folder of images" in caught.value.remedy
    with pytest.raises(ValueError, match="rate_hz"):
        RecordingOptions(rate_hz=0.0)
