"""Logs of two drones with one of everything that is drawn."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.log.mcap_log import McapLog
from missions.ground import rig_library
from missions.ground.journal import setup_record
from path.messages import Role

LEVEL = [1.0, 0.0, 0.0, 0.0]
S_NS = 1_000_000_000


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    for role in Role:
        with McapLog(folder / f"{role.value}.mcap", role.value) as log:
            write_drone(log, role)
            assert log.failed is None
    with McapLog(folder / "world.mcap", "world") as log:
        log.write(
            "/scene",
            0,
            {
                "target_id": 0,
                "min_separation_m": 0.7,
                "boxes": [{"c": [0, 0, 0.1], "s": [1, 1, 1]}],
            },
        )
        for k in range(3):
            bodies = {role.value: {"t": [k, 0, 1], "q": LEVEL, "in_air": True} for role in Role}
            bodies["receiver"]["t"] = [0, 3, 1]
            log.write(
                "/truth", k * S_NS, {**bodies, "objects": [{"id": 0, "t": [1, 2, 0], "yaw": 0.5}]}
            )
        assert log.failed is None
    return folder


def write_drone(log: McapLog, role: Role) -> None:
    """Three seconds of a drone's log."""
    rig = rig_library.load("sim")
    log.write("/setup", 0, setup_record(rig, role, rig_library.mission_of(rig)))
    log.write("/phase", 0, {"phase": "verify", "note": ""})
    for k in range(3):
        now_ns = k * S_NS
        counters = {
            "packets_sent": k,
            "packets_received": k,
            "bytes_sent": 1000 * k,
            "bytes_received": 500 * k,
        }
        log.write("/link", now_ns, {**counters, "dropped": {}})
        log.write("/cpu", now_ns, {"spent_ns": {"thread": k * S_NS // 4, "program": k * S_NS // 2}})
        log.write("/frame", now_ns, {"frame_id": k, "age_ns": 12_000_000})
        log.write("/state", now_ns, {"position_n_m": [k, 0, -1], "velocity_n_mps": [0, 0, 0], "q_n_b": LEVEL,
                                     "mode": "OFFBOARD", "armed": True, "battery": 0.8})  # fmt: skip
        write_frame(log, role, now_ns, k)
        log.image("/image", now_ns, np.full((48, 64, 3), 90, np.uint8))


def write_frame(log: McapLog, role: Role, now_ns: int, k: int) -> None:
    box: dict[str, Any] = {"capture_ns": now_ns, "sequence": k, "box": [10, 10, 20, 20], "point_v_m": [0, 0, 2.0],
                           "sigma_m": 0.05}  # fmt: skip
    if role is Role.SENDER:
        log.write("/target", now_ns, {**box, "frame_id": k})
        pair = {"agreed": True, "counted": True, "iou": 0.8, "tau": 0.4, "count": k, "needed": 3}
        log.write(
            "/agreement", now_ns, {**pair, "own_box": box["box"], "mapped_box": [11, 11, 20, 20]}
        )
        return
    seen = {"position_v_m": [0.1, 0.2, 1.4], "rotation_v_c2": LEVEL, "sigma_m": 0.01}
    log.write(
        "/marker",
        now_ns,
        {**seen, "capture_ns": now_ns, "side_px": 30, "corners_px": [1, 1, 9, 1, 9, 9, 1, 9]},
    )
    log.write(
        "/candidate",
        now_ns,
        {**box, **seen, "prior_px": [20, 20], "region": [5, 5, 40, 40], "found": []},
    )
