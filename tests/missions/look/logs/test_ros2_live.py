"""A flight as topics of ROS 2 while it goes: a second process hears all of them, as rmw_zenoh would."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from drivers.interfaces import PartError
from missions.ground.options.runs import ExportOptions
from missions.look.logs import export
from tests.free_ports import free_port
from tests.missions.look.live.little_flight import little_flight

HEARD = {
    "/sender/target": "geometry_msgs::msg::dds_::PoseWithCovarianceStamped_",
    "/sender/pose": "geometry_msgs::msg::dds_::PoseStamped_",
    "/receiver/pose": "geometry_msgs::msg::dds_::PoseStamped_",
    "/receiver/marker": "geometry_msgs::msg::dds_::PoseWithCovarianceStamped_",
    "/sender/camera/image/compressed": "sensor_msgs::msg::dds_::CompressedImage_",
    "/diagnostics": "diagnostic_msgs::msg::dds_::DiagnosticArray_",
}
READER = """
import json, sys, time, zenoh
from missions.look.logs.ros2 import ros2_types
config = zenoh.Config()
config.insert_json5("mode", '"router"')
config.insert_json5("listen/endpoints", json.dumps([sys.argv[1]]))
config.insert_json5("scouting/multicast/enabled", "false")
types, told = ros2_types(), set()
with zenoh.open(config) as session:
    def heard(sample):
        *topic, kind, digest = str(sample.key_expr).split("/")
        package, _, _, name = kind.split("::")
        ros = f"{package}/msg/{name[:-1]}"
        types.deserialize_cdr(bytes(sample.payload), ros)
        assert digest == types.hash_rihs01(ros)
        topic = "/" + "/".join(topic[1:])
        if topic not in told:
            told.add(topic)
            print(json.dumps([topic, kind, len(bytes(sample.attachment))]), flush=True)
    session.declare_subscriber("0/**", heard)
    print("ready", flush=True)
    sys.stdin.readline()
    print(json.dumps([str(each.ok.key_expr) for each in session.liveliness().get("@ros2_lv/**")]))
"""


def test_a_second_process_hears_every_topic_of_a_flight_while_it_goes(tmp_path: Path) -> None:
    pytest.importorskip("zenoh")
    from missions.look.logs.ros2_live import Topics, publish  # noqa: PLC0415 (an extra)

    router = f"tcp/127.0.0.1:{free_port()}"
    over = threading.Event()
    heard: dict[str, Any] = {}
    with (
        subprocess.Popen(
            [sys.executable, "-c", READER, router],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        ) as reader,
        little_flight(tmp_path) as flight,
        Topics(router) as topics,
    ):
        assert reader.stdin is not None and reader.stdout is not None
        assert reader.stdout.readline() == "ready\n"
        beside = threading.Thread(
            target=publish, args=(tmp_path, topics, lambda: not over.is_set()), daemon=True
        )
        beside.start()
        flight.begin()

        def fly() -> None:
            until_s = time.monotonic() + 40.0
            while not over.is_set() and time.monotonic() < until_s:
                flight.moment()
                time.sleep(0.2)
            reader.kill() if not over.is_set() else None

        flying = threading.Thread(target=fly)
        flying.start()
        for line in reader.stdout:
            topic, kind, attached = json.loads(line)
            heard[topic] = kind
            assert attached == 16 + 8 + 17 + 8 + 11 + 17  # names and values, as of Jazzy
            if HEARD.keys() <= heard.keys():
                break
        reader.stdin.write("\n")
        reader.stdin.flush()
        [listed] = [json.loads(line) for line in reader.stdout if line.startswith('["@')]
        over.set()
        flying.join(10.0)
        beside.join(10.0)
    assert {topic: heard.get(topic) for topic in HEARD} == HEARD
    nodes = [key for key in listed if "/NN/" in key]
    assert [key.endswith("/0/0/NN/%/%/path") for key in nodes] == [True]
    published = {key.split("/")[9].replace("%", "/") for key in listed if "/MP/%/%/path/" in key}
    assert published >= HEARD.keys()


def test_publishing_is_refused_without_what_it_needs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(PartError, match="--publish is of --ros2"):
        export.run(ExportOptions(tmp_path, tum=True, publish="tcp/127.0.0.1:7447"))

    def found(name: str) -> str | None:
        return None if name == "zenoh" else name

    monkeypatch.setattr(export, "find_spec", found)
    with pytest.raises(PartError, match="needs zenoh") as refused:
        export.run(ExportOptions(tmp_path, ros2=True, publish="tcp/127.0.0.1:7447"))
    assert "ros-live" in refused.value.remedy


def test_what_is_no_address_of_a_router_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("zenoh")
    with pytest.raises(PartError, match="--publish nonsense: no address of a router"):
        export.run(ExportOptions(tmp_path, ros2=True, publish="nonsense"))
