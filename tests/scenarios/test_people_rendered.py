"""People looked for with YOLOX in drawn frames, in virtual time: the same seed is the same
flight.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from drivers.detectors.yolox import MODEL_VARIABLE
from missions.fly.handoff.flight import fly_once
from missions.ground import rig_library
from tests.drivers.detectors.test_yolox import WEIGHTS, needs_weights


@needs_weights
def test_a_network_in_one_thread_sees_the_same_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(MODEL_VARIABLE, str(WEIGHTS[0]))
    rig = rig_library.load("sim-rendered-person")
    deadlines = {**rig.mission.get("deadlines", {}), "acquire_s": 4.0, "receiver_ready_s": 1.0}
    # long enough to find, and to follow a while
    rig = replace(rig, mission={**rig.mission, "deadlines": deadlines})
    logs: list[bytes] = []
    for name in ("one", "again"):
        (tmp_path / name).mkdir()
        fly_once(rig, 5, (), tmp_path / name, lambda _: None)
        logs.append((tmp_path / name / "sender.mcap").read_bytes())
    assert logs[0] == logs[1]
