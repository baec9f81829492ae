"""The truth in the log, in the fields that ``missions.look.report.records`` promises."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from drivers.log.mcap_log import LogRecord, McapLog, read_log
from drivers.rig.parts import Rig
from drivers.rig.tables import decode_table
from hil.monitors.truth_log import TruthLog
from hil.world.config import WorldConfig
from hil.world.world import World
from missions.ground import rig_library
from path.geometry.rotation import R_from_quat
from path.messages import Role


@pytest.fixture(scope="module")
def rig() -> Rig:
    return rig_library.load("sim")


@pytest.fixture(scope="module")
def records(rig: Rig, tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[LogRecord]]:
    """The records logged of a world on the ground, two seconds after its start."""
    file: Path = tmp_path_factory.mktemp("truth") / "world.mcap"
    world = World(decode_table(rig.world, WorldConfig, "world"), seed=3)
    with McapLog(file) as log:
        truth = TruthLog(log, epoch_ns=5_000_000_000)
        truth.scene(rig, 0.7, {Role.SENDER: 1_000, Role.RECEIVER: 4_200})
        world.advance(2.0)
        truth.truth(world)
        truth.setpoint_gap(Role.RECEIVER, world)
        truth.violation(2.5, "S9", "S9 at 2.50 s: separation 0.60 m")
        assert log.failed is None
    topics: dict[str, list[LogRecord]] = {}
    for record in read_log(file):
        topics.setdefault(record.topic, []).append(record)
    return topics


def test_the_scene_says_what_does_not_change(rig: Rig, records: dict[str, list[LogRecord]]) -> None:
    (scene,) = records["/scene"]
    record: dict[str, Any] = scene.record
    assert scene.stamp_ns == 5_000_000_000
    assert (record["target_id"], record["min_separation_m"]) == (0, 0.7)
    assert record["clock_offset_ns"] == {"sender": 1_000, "receiver": 4_200}
    assert all(len(box["c"]) == 3 and min(box["s"]) > 0.0 for box in record["boxes"])
    for role in Role:
        camera, own = record["cameras"][role.value], rig.role(role)
        assert {name: camera[name] for name in ("width", "height", "fx", "fy", "cx", "cy")} == {
            name: getattr(own.camera, name) for name in ("width", "height", "fx", "fy", "cx", "cy")
        }
        assert tuple(camera["distortion"]) == own.camera.distortion
        for name in ("T_b_c", "T_b_v"):
            pose, mounted = record["mounts"][role.value][name], getattr(own.mount, name)
            assert pose["t"] == pytest.approx(mounted.t)
            assert R_from_quat(tuple(pose["q"])) == pytest.approx(mounted.R, abs=1e-9)


def test_the_truth_is_where_everything_is(rig: Rig, records: dict[str, list[LogRecord]]) -> None:
    world = World(decode_table(rig.world, WorldConfig, "world"), seed=3)
    world.advance(2.0)
    snapshot = world.snapshot()
    (truth,) = records["/truth"]
    assert truth.stamp_ns == 7_000_000_000
    for role in Role:
        body = truth.record[role.value]
        assert body["t"] == pytest.approx(snapshot.drones[role].T_w_b.t)
        assert R_from_quat(tuple(body["q"])) == pytest.approx(
            snapshot.drones[role].T_w_b.R, abs=1e-9
        )
        assert body["in_air"] is False
    assert truth.record["objects"] == [
        {"id": o.object_id, "t": pytest.approx(o.position_w_m), "yaw": pytest.approx(o.yaw_rad)}
        for o in snapshot.objects
    ]
    assert truth.record["objects"][0]["id"] == 0  # the target


def test_gaps_and_violations_are_written_down(records: dict[str, list[LogRecord]]) -> None:
    (gap,) = records["/setpoint_gap"]
    assert (gap.stamp_ns, gap.record) == (
        7_000_000_000,
        {"role": "receiver", "gap_s": 0.0, "last_ns": None},
    )
    (violation,) = records["/violation"]
    assert violation.stamp_ns == 7_500_000_000
    assert violation.record == {"monitor": "S9", "detail": "S9 at 2.50 s: separation 0.60 m"}
    json.dumps(violation.record)
