"""Every frame of a camera beside the log: what was put in comes out, and whoever puts it in never
waits.
"""

from __future__ import annotations

import threading
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from drivers.interfaces import Frame
from drivers.log import frames as frames_module
from drivers.log.frames import QUEUED, FrameRecorder, frames_of
from drivers.log.mcap_log import VIRTUAL_EPOCH_NS, McapLog, read_log, virtual_log
from drivers.log.video import recorded_frames
from drivers.recordings.recording import open_recording

STEP_NS = 33_333_333
WIDTH, HEIGHT = 320, 240


def frame(number: int, depth: bool = True, width: int = WIDTH) -> Frame:
    random = np.random.default_rng(number)
    color = np.full((HEIGHT, width, 3), (40, 90, 160), np.uint8)
    cv2.rectangle(color, (20 + 3 * number, 60), (80 + 3 * number, 140), (30, 200, 60), -1)
    depth_mm = random.integers(0, 65536, (HEIGHT, width)).astype(np.uint16) if depth else None
    return Frame(10**9 + number * STEP_NS, number, color, depth_mm)


def test_depth_comes_out_as_it_went_in_and_colour_nearly(tmp_path: Path) -> None:
    with virtual_log(tmp_path / "sender.mcap", "sender") as log:
        for number in range(70):
            log.frame(frame(number))
        assert log.failed is None
    back = list(recorded_frames(tmp_path / "sender.frames.mcap"))
    assert [each.stamp_ns for each in back] == [frame(number).stamp_ns for number in range(70)]
    for number, each in enumerate(back):
        was = frame(number)
        assert each.depth_mm is not None
        assert was.depth_mm is not None
        assert np.array_equal(each.depth_mm, was.depth_mm)
        assert np.abs(each.color.astype(int) - was.color).mean() < 3.0
        # each message is its own frame's, not an earlier one's
        moved = each.color[100, :, 1] > 145
        assert abs(int(moved.argmax()) - (20 + 3 * number)) <= 1, (
            "each message is its own frame's, not an earlier one's"
        )


def test_strangers_read_it(tmp_path: Path) -> None:
    with virtual_log(tmp_path / "sender.mcap", "sender") as log:
        for number in range(3):
            log.frame(frame(number))
    with (tmp_path / "sender.frames.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        assert summary is not None and summary.statistics is not None
        assert summary.statistics.message_count == 6
        found = [
            (channel.topic, message.log_time, decoded)
            for _, channel, message, decoded in reader.iter_decoded_messages()
        ]
    video: Any = [each for each in found if each[0] == "/video"]
    depth: Any = [each for each in found if each[0] == "/depth"]
    assert [each[1] - VIRTUAL_EPOCH_NS for each in video] == [
        frame(number).stamp_ns for number in range(3)
    ]
    assert video[0][2].format == "h264" and video[0][2].frame_id == "sender/camera"
    assert video[0][2].data[:5] in (b"\0\0\0\1\x67", b"\0\0\0\1\x09"), (
        "a key frame begins with its parameter sets"
    )
    assert (depth[0][2].encoding, depth[0][2].step, depth[0][2].width) == (
        "16UC1",
        2 * WIDTH,
        WIDTH,
    )


def test_it_plays_as_a_recording(tmp_path: Path) -> None:
    with virtual_log(tmp_path / "sender.mcap", "sender") as log:
        for number in range(4):
            log.frame(frame(number))
    played = list(open_recording(tmp_path / "sender.frames.mcap").frames())
    assert [each.stamp_ns for each in played] == [frame(number).stamp_ns for number in range(4)]
    assert played[3].load().depth_mm is not None


def test_a_killed_program_leaves_what_was_written(tmp_path: Path) -> None:
    recorder = FrameRecorder(tmp_path / "sender.mcap", "sender", 0, waits=True)
    for number in range(5):
        recorder.take(frame(number))
    whole = frames_of(tmp_path / "sender.mcap").read_bytes()  # nothing was closed
    recorder.close()
    (tmp_path / "cut.frames.mcap").write_bytes(whole)
    assert len(list(recorded_frames(tmp_path / "cut.frames.mcap"))) == 5
    (tmp_path / "cut.frames.mcap").write_bytes(whole[:-1000])
    assert len(list(recorded_frames(tmp_path / "cut.frames.mcap"))) == 4


def test_a_flight_never_waits_for_the_recorder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    going, blocked = threading.Event(), threading.Event()

    def hang(*_: object) -> None:
        blocked.set()
        going.wait(60.0)

    monkeypatch.setattr(frames_module._FrameFile, "write", hang)
    with McapLog(tmp_path / "sender.mcap", "sender") as log:
        log.frame(frame(0))
        assert blocked.wait(60.0)
        began_s = time.perf_counter()
        for number in range(1, 60):
            log.frame(frame(number))
        took_s = time.perf_counter() - began_s
        going.set()
    assert took_s < 30.0  # the recorder hangs for twice that, or until this is told
    (told, *_) = [
        each.record for each in read_log(tmp_path / "sender.mcap") if each.topic == "/recording"
    ][-1:]
    assert told["dropped"] >= told["taken"] - QUEUED - 2 > 10


def test_what_is_wrong_with_the_recording_ends_neither_log_nor_flight(tmp_path: Path) -> None:
    with virtual_log(tmp_path / "a.mcap", "a") as log:
        log.frame(frame(0, width=321))
        log.frame(frame(1, width=321))
        log.write("/note", 1, {"note": "goes on"})
        assert log.failed is not None and "even" in log.failed
    assert any(each.topic == "/note" for each in read_log(tmp_path / "a.mcap"))


def test_recording_costs_less_than_its_share_of_a_core(tmp_path: Path) -> None:
    """15 % of a core at 640 x 480, 30 Hz, is 5 ms a frame; measured by the thread's own processor
    time.

    Twice the limit is let pass, and what is above it is measured again: a busy computer's caches
    are others' too.
    """
    limit_ns = 2.0 * 0.15e9
    spent_ns = (spent_a_second(tmp_path / f"{number}.mcap") for number in range(3))
    assert any(each < limit_ns for each in spent_ns)


def spent_a_second(log: Path) -> float:
    """The recorder's processor time for a second of frames, ns."""
    random = np.random.default_rng(1)
    ground = cv2.GaussianBlur(random.integers(0, 255, (520, 760, 3)).astype(np.uint8), (0, 0), 5.0)
    recorder = FrameRecorder(log, "a", 0, waits=True)
    for number in range(45):
        color = ground[number // 2 : number // 2 + 480, number : number + 640]
        depth = (1500 + random.normal(0.0, 3.0, (480, 640))).astype(np.uint16)
        recorder.take(Frame(number * STEP_NS, number, np.ascontiguousarray(color, np.uint8), depth))
    recorder.close()
    assert recorder.failed is None
    return recorder.counts.spent_ns / 45 * 30
