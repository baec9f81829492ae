"""A run as a bag of ROS 2: two readers of others decode every message, and find what was logged."""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from drivers.interfaces import PartError
from drivers.log.mcap_log import read_log
from missions.ground.options.runs import ExportOptions
from missions.look.logs.export import run
from missions.look.logs.ros2 import made
from path.geometry.rotation import R_from_quat

WANTED = {
    "/tf": "tf2_msgs/msg/TFMessage",
    "/sender/camera/camera_info": "sensor_msgs/msg/CameraInfo",
    "/sender/camera/image/compressed": "sensor_msgs/msg/CompressedImage",
    "/sender/fix": "sensor_msgs/msg/NavSatFix",
    "/sender/pose": "geometry_msgs/msg/PoseStamped",
    "/sender/target": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "/receiver/marker": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "/receiver/detections": "vision_msgs/msg/Detection2DArray",
    "/receiver/markers": "visualization_msgs/msg/MarkerArray",
    "/world/truth/sender": "geometry_msgs/msg/PoseStamped",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
    "/rosout": "rcl_interfaces/msg/Log",
}


def exported(folder: Path, out: Path) -> Path:
    assert run(ExportOptions(folder, ros2=True, out=out)) == 0
    return out / "ros2"


def by_rosbags(bag: Path) -> list[tuple[str, str, int, Any]]:
    """Return topic, type, instant and message of each, by the definitions that are in the bag."""
    with AnyReader([bag]) as reader:
        return [
            (of.topic, of.msgtype, utc_ns, reader.deserialize(data, of.msgtype))
            for of, utc_ns, data in reader.messages()
        ]


def test_two_readers_of_others_decode_every_message(run_folder: Path, tmp_path: Path) -> None:
    bag = exported(run_folder, tmp_path / "out")
    mine = by_rosbags(bag)
    kinds = {topic: kind for topic, kind, _, _ in mine}
    assert WANTED.items() <= kinds.items()
    with (bag / "ros2.mcap").open("rb") as file:
        theirs = list(
            make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
        )
    assert Counter(topic for topic, _, _, _ in mine) == Counter(m.channel.topic for m in theirs)
    assert {m.channel.message_encoding for m in theirs} == {"cdr"}
    assert {m.schema.encoding for m in theirs if m.schema is not None} == {"ros2msg"}
    # as often as it was logged, and again over the first export
    states = [r for r in read_log(run_folder / "sender.mcap") if r.topic == "/state"]
    assert sum(topic == "/sender/pose" for topic, *_ in mine) == len(states)
    assert exported(run_folder, tmp_path / "out") == bag


def test_what_they_read_is_what_was_logged(run_folder: Path, tmp_path: Path) -> None:
    every = by_rosbags(exported(run_folder, tmp_path / "out"))
    log = list(read_log(run_folder / "sender.mcap"))

    def of(topic: str) -> list[Any]:
        return [message for own, _, _, message in every if own == topic]

    state = next(r.record for r in log if r.topic == "/state")
    pose = of("/sender/pose")[0].pose
    assert xyz(pose.position) == pytest.approx(state["position_n_m"])
    assert wxyz(pose.orientation) == pytest.approx(state["q_n_b"])
    target = next(r.record for r in log if r.topic == "/target" and r.record["point_v_m"])
    sure = of("/sender/target")[0].pose
    assert xyz(sure.pose.position) == pytest.approx(target["point_v_m"])
    sigma_m = target["sigma_m"]
    expected = np.diag([sigma_m**2] * 3 + [0.0] * 3).ravel()
    assert sure.covariance == pytest.approx(expected)
    box = next(r.record["box"] for r in log if r.topic == "/target" and r.record["box"])
    seen = of("/sender/detections")[0].detections[0]
    corner = seen.bbox.center.position.x - 0.5 * seen.bbox.size_x
    assert (corner, seen.bbox.size_y) == pytest.approx((box[0], box[3]))
    assert seen.results[0].hypothesis.class_id == "target"
    camera = next(r.record for r in log if r.topic == "/setup")["camera"]
    info = of("/sender/camera/camera_info")[0]
    assert (info.width, info.k[0], info.d.tolist()) == (
        camera["width"], camera["fx"], camera["distortion"]
    )  # fmt: skip
    phases = [r.record["phase"] for r in log if r.topic == "/phase"]
    status = [each for array in of("/diagnostics") for each in array.status]
    assert [each.message for each in status if each.name == "sender: phase"] == phases
    jpeg = of("/sender/camera/image/compressed")[0]
    assert jpeg.format == "jpeg" and bytes(jpeg.data[:2]) == b"\xff\xd8"


def test_its_frames_lead_from_the_world_to_the_drone(run_folder: Path, tmp_path: Path) -> None:
    every = by_rosbags(exported(run_folder, tmp_path / "out"))
    frames = {
        each.child_frame_id: (each.header.frame_id, each.transform)
        for topic, _, _, message in every
        if topic == "/tf"
        for each in message.transforms
    }
    assert frames["n"][0] == "world"
    assert frames["sender/body"][0] == "n"
    assert frames["sender/camera"][0] == "sender/body"
    assert frames["sender/marker"][0] == "sender/body"
    north = R_from_quat(wxyz(frames["n"][1].rotation)) @ np.array([1.0, 0.0, 0.0])
    assert north == pytest.approx([0.0, 1.0, 0.0], abs=1e-9)  # which is y in ENU


def test_what_is_not_installed_is_named(
    run_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def nothing(_: str) -> None:
        return None

    monkeypatch.setattr("missions.look.logs.export.find_spec", nothing)
    with pytest.raises(PartError, match="--ros2 needs rosbags and mcap_protobuf"):
        run(ExportOptions(run_folder, ros2=True, out=tmp_path / "out"))


def test_a_field_that_a_message_does_not_have_is_an_error() -> None:
    from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415

    store = get_typestore(Stores.ROS2_JAZZY)
    with pytest.raises(ValueError, match="Header has no frame"):
        made(store, "std_msgs/msg/Header", {"frame": "world"})
    assert made(store, "std_msgs/msg/Header", {}).frame_id == ""
    assert "rclpy" not in sys.modules


def xyz(of: Any) -> tuple[float, float, float]:
    return of.x, of.y, of.z


def wxyz(of: Any) -> tuple[float, float, float, float]:
    return of.w, of.x, of.y, of.z
