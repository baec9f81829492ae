"""Bare H.264 streams: a rate is asked for, what was lost keeps its place in time, and what is torn
is no frame.
"""

from __future__ import annotations

import random
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from drivers.recordings.h264 import pictures
from drivers.recordings.recording import RecordingError, RecordingOptions, open_recording
from missions.field.detect import run
from missions.ground.options.field import DetectOptions

WIDTH, HEIGHT, PICTURES, GROUP = 160, 96, 60, 20
RATE_HZ = 30.0
AT_RATE = RecordingOptions(rate_hz=RATE_HZ)


def coded(
    slices: int = 1, group: int = GROUP, count: int = PICTURES, both_ways: str = ""
) -> list[bytes]:
    """Packets of a stream whose picture n is a bar at column 2 n, on noise that no codec takes for
    nothing.
    """
    codec: Any = av.CodecContext.create("libx264", "w")
    codec.width, codec.height, codec.pix_fmt = WIDTH, HEIGHT, "yuv420p"
    codec.time_base, codec.framerate, codec.gop_size = Fraction(1, 30), 30, group
    parameters = f"keyint={group}:scenecut=0:slices={slices}"
    codec.options = {"preset": "ultrafast", "tune": "zerolatency", "x264-params": parameters}
    if both_ways:
        codec.max_b_frames = 3
        codec.options = {"preset": "medium", "x264-params": f"{parameters}:{both_ways}"}
    packets: list[bytes] = []
    for number in range(count):
        noise = np.random.default_rng(number).integers(30, 50, (HEIGHT, WIDTH, 1))
        picture = np.repeat(noise, 3, axis=2).astype(np.uint8)
        picture[:, 2 * number : 2 * number + 12] = 220
        frame: Any = av.VideoFrame.from_ndarray(picture, format="bgr24")
        frame.pts = number
        packets += [bytes(packet) for packet in codec.encode(frame)]
    return packets + [bytes(packet) for packet in codec.encode(None)]


def shown(file: Path) -> list[tuple[int, int]]:
    """Of each frame, the picture that its stamp says (from the first frame) and the one that its
    bar says.
    """
    found: list[tuple[int, int]] = []
    for frame in open_recording(file, AT_RATE).frames():
        columns = frame.load().color.mean(axis=(0, 2)) > 130.0
        found.append(
            (round(frame.stamp_ns * RATE_HZ / 1e9), round(float(np.flatnonzero(columns)[0]) / 2))
        )
    return found


def written(folder: Path, parts: Sequence[bytes]) -> Path:
    file = folder / "film.h264"
    file.write_bytes(b"".join(parts))
    return file


@pytest.mark.parametrize("slices", [1, 4])
def test_a_whole_stream_has_all_its_pictures_at_the_rate_that_is_given(
    tmp_path: Path, slices: int
) -> None:
    file = written(tmp_path, coded(slices))
    assert shown(file) == [(n, n) for n in range(PICTURES)]
    recording = open_recording(file, AT_RATE)
    list(recording.frames())
    assert recording.damage == ""


@pytest.mark.parametrize(
    "kind", ["bframes=2", "bframes=3:b-pyramid=normal", "bframes=2:open-gop=1"]
)
@pytest.mark.parametrize("cut", [0, 5])
def test_pictures_that_are_coded_in_another_order_have_the_stamps_of_their_own(
    tmp_path: Path, kind: str, cut: int
) -> None:
    frames = shown(written(tmp_path, coded(both_ways=kind)[cut:]))
    begin = 0 if cut == 0 else GROUP
    assert [bar for _, bar in frames][::PICTURES] == [begin]
    assert all(stamp + begin == bar for stamp, bar in frames)
    # Of open groups FFmpeg believes less than there is until the second key frame.
    assert len(frames) == PICTURES - begin or (cut and "open" in kind)


def test_a_stream_whose_pictures_change_their_size_is_refused_with_both(tmp_path: Path) -> None:
    codec: Any = av.CodecContext.create("libx264", "w")
    codec.width, codec.height, codec.pix_fmt, codec.time_base = 64, 48, "yuv420p", Fraction(1, 30)
    small: Any = av.VideoFrame.from_ndarray(np.zeros((48, 64, 3), np.uint8), format="bgr24")
    others = [bytes(packet) for packet in (*codec.encode(small), *codec.encode(None))]
    file = written(tmp_path, [*coded(count=5), *others])
    with pytest.raises(RecordingError, match=r"frame 5: 64x48 px, .* before it have 160x96 px"):
        shown(file)


@pytest.mark.parametrize("suffix", [".h264", ".264", ".mjpeg"])
def test_a_bare_stream_without_a_rate_is_refused(tmp_path: Path, suffix: str) -> None:
    file = tmp_path / f"film{suffix}"
    if suffix == ".mjpeg":
        picture: Any = av.VideoFrame.from_ndarray(
            np.full((HEIGHT, WIDTH, 3), 90, np.uint8), format="bgr24"
        )
        codec: Any = av.CodecContext.create("mjpeg", "w")
        codec.width, codec.height, codec.pix_fmt, codec.time_base = (
            WIDTH,
            HEIGHT,
            "yuvj420p",
            Fraction(1, 30),
        )
        file.write_bytes(b"".join(bytes(p) for _ in range(5) for p in codec.encode(picture)))
    else:
        file.write_bytes(b"".join(coded(count=5)))
    with pytest.raises(
        RecordingError, match="does not say how many pictures a second it has"
    ) as caught:
        open_recording(file)
    assert "--rate-hz" in caught.value.remedy
    assert len(list(open_recording(file, AT_RATE).frames())) == 5


@pytest.mark.parametrize("cut", [1, 7, 19])
def test_a_stream_that_begins_within_a_group_gives_frames_from_the_next_key_frame_on(
    tmp_path: Path, cut: int
) -> None:
    file = written(tmp_path, coded()[cut:])
    assert shown(file) == [(n, GROUP + n) for n in range(PICTURES - GROUP)]
    recording = open_recording(file, AT_RATE)
    list(recording.frames())
    assert recording.damage.startswith(f"0 pictures are missing and {GROUP - cut} are torn")


@pytest.mark.parametrize(
    "lost", [(5,), (5, 6, 7), (25,), (5, 44), (39,), (18, 19), (17, 18, 19, 20, 21), (40, 41)]
)
def test_lost_pictures_keep_their_place_in_time_and_what_leans_on_them_is_no_frame(
    tmp_path: Path, lost: tuple[int, ...]
) -> None:
    packets = coded()
    file = written(
        tmp_path, [packet for number, packet in enumerate(packets) if number not in lost]
    )
    frames = shown(file)
    fresh = {n for n in range(PICTURES) if not any(n - n % GROUP <= each <= n for each in lost)}
    assert {bar for _, bar in frames} == fresh
    # A group may end early, and of three groups two say nothing of their length: nothing tells what
    # is missing there.
    if lost not in ((39,), (18, 19), (17, 18, 19, 20, 21)):
        assert all(stamp == bar for stamp, bar in frames)


@pytest.mark.parametrize("slices", [1, 3])
@pytest.mark.parametrize("seed", range(8))
def test_of_a_stream_that_lost_datagrams_no_torn_picture_is_a_frame(
    tmp_path: Path, seed: int, slices: int
) -> None:
    chance = random.Random(seed)
    stream = b"".join(coded(slices))
    parts = [stream[at : at + 700] for at in range(0, len(stream), 700)]
    kept = [part for k, part in enumerate(parts) if k == 0 or chance.random() > 0.06]
    lost = len(kept) < len(parts)
    file = written(tmp_path, kept)
    whole = _decoded(coded(slices))
    recording = open_recording(file, AT_RATE)
    frames = list(recording.frames())
    for frame in frames:
        color = frame.load().color
        differences = [np.abs(color.astype(int) - each.astype(int)).max() for each in whole]
        assert min(differences) == 0, "a frame that was never filmed"
    assert (recording.damage != "") == lost
    assert len(frames) < PICTURES or not lost


def _decoded(packets: Sequence[bytes]) -> list[Any]:
    codec: Any = av.CodecContext.create("h264", "r")
    codec.thread_type = "NONE"
    found = [frame for packet in packets for frame in codec.decode(av.Packet(packet))]
    return [frame.to_ndarray(format="bgr24") for frame in (*found, *codec.decode(None))]


def test_noise_is_no_stream_and_ends(tmp_path: Path) -> None:
    for seed in range(5):
        noise = random.Random(seed).randbytes(20_000)
        assert isinstance(pictures(noise.replace(b"\x07\x13", b"\0\0\1")), list)
    file = written(tmp_path, [random.Random(9).randbytes(20_000)])
    with pytest.raises(RecordingError, match=r"film\.h264"):
        open_recording(file, AT_RATE)


def test_a_stream_without_any_key_frame_says_so(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"no frames in it: .* 5 are torn|cannot be read"):
        open_recording(written(tmp_path, coded()[1:6]), AT_RATE)


def test_detect_tells_what_was_no_frame(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = written(tmp_path, coded()[7:])
    assert run(DetectOptions(file, rig="sim-rendered", rate_hz=30.0)) == 0
    said = capsys.readouterr().out
    assert "40 frames" in said
    assert "13 are torn: they are no frames" in said
