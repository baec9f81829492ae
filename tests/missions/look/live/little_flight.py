"""A flight of one moment, logged as drones log: both compare their views, and D1 has the target."""

from __future__ import annotations

import time
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from drivers.log.mcap_log import McapLog
from missions.ground import rig_library
from missions.ground.journal import setup_record
from path.messages import Role

CLEAR_M = 0.75
LEVEL_Q = (1.0, 0.0, 0.0, 0.0)
CORNERS = ((-8.0, -8.0), (9.0, -8.0), (9.0, 7.0))
D1_M = (2.5, -2.0, -1.5)
D2_M = (1.5, -1.5, -2.1)
OFF_M = (0.25, -0.5)
OWN_BOX = (290.0, 230.0, 60.0, 50.0)
MAPPED_BOX = (293.0, 232.0, 58.0, 51.0)
D2_BOX = (400.0, 210.0, 40.0, 30.0)
MARKER_PX = (200.0, 190.0, 220.0, 192.0, 219.0, 212.0, 199.0, 210.0)
LOOK_ALIKE = (80.0, 60.0, 30.0, 30.0, 4.0, 0.05)
IMAGE = np.full((480, 640, 3), 96, np.uint8)


class LittleFlight:
    """The two drones' logs."""

    def __init__(self, sender: McapLog, receiver: McapLog) -> None:
        self.logs = {Role.SENDER: sender, Role.RECEIVER: receiver}
        self.sender = sender
        self.receiver = receiver
        self.frames = 0
        # of its GPS and of the pilot's radio
        self.told: dict[str, Any] = {"gps_fix": 6, "satellites": 17, "radio": True}

    def begin(self) -> None:
        """What does not change."""
        rig = rig_library.load("sim")
        config = rig_library.mission_of(rig)
        config = replace(config, guard=replace(config.guard, corners_m=CORNERS, clear_m=CLEAR_M))
        now_ns = time.monotonic_ns()
        for role, log in self.logs.items():
            log.write("/setup", now_ns, setup_record(rig, role, config))
            log.write("/home", now_ns, {"off_m": OFF_M})
            log.write("/phase", now_ns, {"phase": "take-off", "note": ""})

    def moment(self) -> int:
        """One frame of each drone, and what they know then; returns its stamp."""
        now_ns = time.monotonic_ns()
        self.frames += 1
        self._states(now_ns)
        if self.frames == 1:
            for log in self.logs.values():
                log.write("/phase", now_ns, {"phase": "verify", "note": ""})
            self.sender.write("/responsibility", now_ns, {"responsible": True})
        seen = {"frame_id": self.frames, "sequence": self.frames, "capture_ns": now_ns}
        place = {"point_v_m": (0.0, 0.0, -3.0), "sigma_m": 0.04, "depth_sigma_m": 0.06}
        target = {**seen, **place, "box": OWN_BOX, "depth_m": 2.8, "beside": LOOK_ALIKE}
        self.sender.write("/target", now_ns, target)
        marker = {"capture_ns": now_ns, "position_v_m": (0.6, 0.0, 0.8), "corners_px": MARKER_PX}
        marker |= {"rotation_v_c2": LEVEL_Q, "sigma_m": 0.005}
        self.receiver.write("/marker", now_ns, marker)
        self.receiver.write("/candidate", now_ns, {**seen, "box": D2_BOX})
        pair: dict[str, Any] = {"agreed": True, "count": 12, "needed": 30, "evidence": 2.5}
        pair |= {"evidence_needed": 3.3, "mapped_box": MAPPED_BOX, "capture_ns": now_ns}
        self.sender.write("/agreement", now_ns, pair)
        self.sender.write("/late", now_ns, {"loop_ns": 42_000_000})
        for log in self.logs.values():
            log.image("/image", now_ns, IMAGE)
        return now_ns

    def _states(self, now_ns: int) -> None:
        for log, place in ((self.sender, D1_M), (self.receiver, D2_M)):
            state = {"position_n_m": place, "velocity_n_mps": (0.3, 0.4, 0.0), "q_n_b": LEVEL_Q}
            state |= {"mode": "offboard", "armed": True, "battery": 0.8}
            log.write("/state", now_ns, {**state, **self.told})

    def link(self, second: int, packets: int, dropped: int = 0) -> None:
        """The link's counters, once a second."""
        counters = {"packets_received": packets, "bytes_received": 80 * packets, "bytes_sent": 100}
        for log in self.logs.values():
            stamp_ns = time.monotonic_ns() + second * 1_000_000_000
            log.write("/link", stamp_ns, {**counters, "dropped": {"unproven": dropped}})


@contextmanager
def little_flight(folder: Path) -> Generator[LittleFlight, None, None]:
    """Logs in a folder, written as they come."""
    with (
        McapLog(folder / "sender.mcap", "sender") as sender,
        McapLog(folder / "receiver.mcap", "receiver") as receiver,
    ):
        yield LittleFlight(sender, receiver)
