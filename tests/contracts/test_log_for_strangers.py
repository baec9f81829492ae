"""Logs as programs written by others read them: mcap's own reader, JSON Schema, Foxglove's messages
in protobuf.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from mcap.reader import McapReader, make_reader
from mcap_protobuf.decoder import DecoderFactory

from drivers.interfaces import Frame
from drivers.log.mcap_log import VIRTUAL_EPOCH_NS, McapLog, virtual_log
from drivers.log.topics import TOPICS, schema_of
from tests.flown import flown_once

SCALARS = ("boolean", "string", "number", "integer")
LOGS = ("sender.mcap", "receiver.mcap", "sender.guard.mcap", "world.mcap")


@dataclass(frozen=True)
class Seen:
    """A message as a stranger's reader gives it; ``content`` is a dict, or a message of
    protobuf.
    """

    topic: str
    schema: str
    utc_ns: int
    content: Any


def seen(path: Path) -> Iterator[Seen]:
    protobuf = DecoderFactory()
    with path.open("rb") as file:
        for schema, channel, message in reader_of(file).iter_messages():
            assert schema is not None
            decode: Any = json.loads
            if channel.message_encoding == "protobuf":
                decode = protobuf.decoder_for("protobuf", schema)
            yield Seen(channel.topic, schema.name, message.log_time, decode(message.data))


def reader_of(file: Any) -> McapReader:
    return make_reader(file)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return flown_once(tmp_path_factory, 8, "link_loss=0.3")


def fields_are_read(properties: Mapping[str, Any]) -> None:
    """By the rules of Foxglove's reader of JSON Schema: one type a field, no list of lists."""
    for name, field in properties.items():
        item = field["items"] if field["type"] == "array" else field
        assert item["type"] in (*SCALARS, "object"), name
        if item["type"] == "object":
            fields_are_read(item["properties"])


@pytest.mark.parametrize("topic", TOPICS)
def test_a_schema_is_one_and_foxgloves_reader_understands_it(topic: str) -> None:
    schema = json.loads(schema_of(topic))
    jsonschema.Draft202012Validator.check_schema(schema)
    assert schema["description"]
    fields_are_read(schema["properties"])


@pytest.mark.parametrize("log", LOGS)
def test_every_record_of_a_run_is_as_its_schema_says(folder: Path, log: str) -> None:
    records = [message for message in seen(folder / log) if message.schema.startswith("path.")]
    assert {record.topic for record in records} <= TOPICS.keys()
    validators = {
        r.topic: jsonschema.Draft202012Validator(json.loads(schema_of(r.topic))) for r in records
    }
    validated = set[tuple[str, object]]()
    for record in records:
        shape = (record.topic, shape_of(record.content))
        if shape not in validated:
            validators[record.topic].validate(record.content)
            validated.add(shape)


def shape_of(value: object) -> object:
    """Return what a schema says of a value: its type, and nothing of its size. A whole number may
    have been written as 2.0.
    """
    if isinstance(value, dict):
        return tuple((key, shape_of(inner)) for key, inner in value.items())
    if isinstance(value, list):
        return (list, frozenset(shape_of(inner) for inner in value))
    if isinstance(value, float):
        return (float, value.is_integer())
    return type(value)


def test_a_log_has_an_index_and_says_whose_it_is_and_of_which_clock(folder: Path) -> None:
    with (folder / "receiver.mcap").open("rb") as file:
        reader = reader_of(file)
        summary = reader.get_summary()
        assert summary is not None and summary.statistics is not None
        assert len(summary.chunk_indexes) > 1
        assert summary.statistics.message_start_time >= VIRTUAL_EPOCH_NS
        (about,) = reader.iter_metadata()
        middle = (summary.statistics.message_start_time + summary.statistics.message_end_time) // 2
        late = list(reader.iter_messages(topics=["/marker"], starting_at=middle))
    assert about.metadata == {
        "name": "receiver",
        "utc_minus_stamp_ns": str(VIRTUAL_EPOCH_NS - 4_200_000_000),
    }
    assert late
    assert all(message.log_time >= middle for _, _, message in late)


def test_transforms_calibration_boxes_scene_place_and_words_are_foxgloves(folder: Path) -> None:
    by_topic: dict[str, list[Seen]] = {}
    for message in (*seen(folder / "sender.mcap"), *seen(folder / "receiver.mcap")):
        if message.schema.startswith("foxglove."):
            by_topic.setdefault(message.topic, []).append(message)
    assert {topic: {m.schema for m in found} for topic, found in by_topic.items()} == {
        "/tf": {"foxglove.FrameTransforms"},
        "/calibration": {"foxglove.CameraCalibration"},
        "/annotations": {"foxglove.ImageAnnotations"},
        "/3d": {"foxglove.SceneUpdate"},
        "/position": {"foxglove.LocationFix"},
        "/log": {"foxglove.Log"},
    }
    frames = {
        (t.parent_frame_id, t.child_frame_id) for m in by_topic["/tf"] for t in m.content.transforms
    }
    assert frames >= {("world", "n"), ("n", "sender/body"), ("sender/body", "sender/camera")}
    assert frames >= {("sender/body", "sender/marker"), ("receiver/camera", "receiver/marker_seen")}
    assert all(m.content.K[0] > 100.0 and len(m.content.D) == 5 for m in by_topic["/calibration"])
    assert any("IoU" in text.text for m in by_topic["/annotations"] for text in m.content.texts)
    # box, region, prior, marker
    assert any(len(m.content.points) >= 4 for m in by_topic["/annotations"])
    assert {e.id for m in by_topic["/3d"] for e in m.content.entities} == {
        "sender/body", "sender/frustum", "sender/marker", "sender/target", "sender/fence",
        "receiver/body", "receiver/frustum", "receiver/separation", "receiver/target", "receiver/fence",
    }  # fmt: skip
    assert any(m.content.message.startswith("phase verify") for m in by_topic["/log"])
    for message in by_topic["/position"]:
        stamp = message.content.timestamp
        assert stamp.seconds * 1_000_000_000 + stamp.nanos == message.utc_ns


def test_an_image_is_there_with_what_is_drawn_over_it(tmp_path: Path) -> None:
    image = np.full((48, 64, 3), 90, np.uint8)
    with McapLog(tmp_path / "a.mcap", "D1") as log:
        log.write("/track", 1_000_000_000, {"box": [1.0, 2.0, 3.0, 4.0], "reason": None})
        log.write("/track", 1_033_000_000, {"box": [2.0, 2.0, 3.0, 4.0], "reason": None})
        log.image("/image", 1_033_000_000, image)
        assert log.failed is None
    messages = list(seen(tmp_path / "a.mcap"))
    (shown,) = (m for m in messages if m.topic == "/image")
    assert shown.schema == "foxglove.CompressedImage"
    assert shown.content.data.startswith(b"\xff\xd8")
    assert shown.content.frame_id == "D1/camera"
    *_, drawn = (m for m in messages if m.topic == "/annotations")
    assert drawn.utc_ns == shown.utc_ns
    assert [(p.x, p.y) for p in drawn.content.points[0].points] == [
        (2.0, 2.0),
        (5.0, 2.0),
        (5.0, 6.0),
        (2.0, 6.0),
    ]


def imported_by_rerun(log: Path, folder: Path) -> set[str]:
    """The components that Rerun's own importer of MCAP makes of a log, as
    ``archetype:component``.
    """
    import rerun  # noqa: PLC0415 (only here: each worker would import it)

    recording = rerun.RecordingStream("contract", recording_id=log.stem)
    recording.save(folder / "imported.rrd")
    recording.log_file_from_path(log)
    recording.flush()
    recording.disconnect()
    printed = subprocess.run(
        [str(Path(sys.executable).with_name("rerun")), "rrd", "print", "-vv", str(folder / "imported.rrd")],
        capture_output=True, text=True, timeout=600.0, check=True,
    )  # fmt: skip
    return set(re.findall(r"\b[A-Z]\w+:[a-z]\w+", printed.stdout))


def test_reruns_importer_reads_poses_calibration_place_and_words(
    folder: Path, tmp_path: Path
) -> None:
    assert imported_by_rerun(folder / "receiver.mcap", tmp_path) >= {
        "Pinhole:image_from_camera", "Transform3D:translation", "Transform3D:quaternion", "GeoPoints:positions",
        "TextLog:text",
    }  # fmt: skip


def test_reruns_importer_reads_every_frame_as_video_and_depth(tmp_path: Path) -> None:
    with virtual_log(tmp_path / "sender.mcap", "sender") as log:
        for number in range(3):
            color, depth_mm = np.full((48, 64, 3), 90, np.uint8), np.full((48, 64), 1500, np.uint16)
            log.frame(Frame(1_000_000_000 + number, number, color, depth_mm))
        log.image("/image", 1_000_000_000, np.full((48, 64, 3), 90, np.uint8))
    frames = imported_by_rerun(tmp_path / "sender.frames.mcap", tmp_path)
    assert frames >= {"VideoStream:codec", "VideoStream:sample", "Image:buffer"}
    assert imported_by_rerun(tmp_path / "sender.mcap", tmp_path) >= {"EncodedImage:blob"}
