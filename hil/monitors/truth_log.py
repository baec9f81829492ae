"""The world's own log: what was true, in the fields that the report reads (topics ``/scene``,
``/truth`` ...).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from drivers.interfaces import Log
from drivers.log.topics import camera_record
from drivers.rig.obstacle import Obstacle
from drivers.rig.parts import Rig, RoleRig
from hil.geometric.scene import parts_of
from hil.world.targets import TargetConfig
from hil.world.world import World
from path.geometry.rotation import quat_from_R
from path.geometry.transforms import Pose
from path.messages import Role


class TruthLog:
    """Writes the truth of one world; stamps are of the world's clock plus ``epoch_ns``."""

    def __init__(self, log: Log, epoch_ns: int = 0) -> None:
        self._log = log
        self._epoch_ns = epoch_ns
        self._shown: dict[Role, tuple[str, bool]] = {}

    def scene(
        self,
        rig: Rig,
        min_separation_m: float,
        clock_offset_ns: Mapping[Role, int],
        target: TargetConfig | None = None,
        obstacles: Sequence[Obstacle] = (),
    ) -> None:
        """Write what does not change: once, first."""
        own = target or TargetConfig()
        parts = parts_of(own.kind, own.stretch)
        record = {
            "target_id": 0,
            "min_separation_m": min_separation_m,
            "kind": own.kind,
            "boxes": [
                {"c": row[0:3], "s": [2.0 * half for half in row[3:6]]} for row in parts.tolist()
            ],
            "clock_offset_ns": {role.value: offset for role, offset in clock_offset_ns.items()},
            "cameras": {role.value: camera_record(rig.role(role).camera) for role in Role},
            "mounts": {role.value: _mount(rig.role(role)) for role in Role},
        }
        if obstacles:
            record["obstacles"] = [asdict(each) for each in obstacles]
        self._log.write("/scene", self._epoch_ns, record)

    def truth(self, world: World) -> None:
        """Write the poses of both bodies and of every object, now."""
        snapshot = world.snapshot()
        record: dict[str, Any] = {
            role.value: {**_pose(drone.T_w_b), "in_air": not world.drone(role).on_ground}
            for role, drone in snapshot.drones.items()
        }
        record["objects"] = [
            {"id": o.object_id, "t": o.position_w_m, "yaw": o.yaw_rad} for o in snapshot.objects
        ]
        self._log.write("/truth", self._epoch_ns + round(world.time_s * 1e9), record)

    def modes(self, world: World) -> None:
        """Write the modes of both autopilots, whenever they change."""
        for role in Role:
            autopilot = world.drone(role).autopilot
            shown = autopilot.mode.value, autopilot.armed
            if self._shown.get(role) != shown:
                self._shown[role] = shown
                record = {
                    "role": role.value,
                    "mode": autopilot.mode.value,
                    "armed": autopilot.armed,
                }
                self._log.write("/autopilot", self._epoch_ns + round(world.time_s * 1e9), record)

    def fault(self, name: str, at_ns: int) -> None:
        """A fault that began, at an instant of the log's own stamps."""
        self._log.write("/fault", at_ns, {"fault": name})

    def setpoint_gap(self, role: Role, world: World) -> None:
        """The longest time between two setpoints of a vehicle in offboard control, and when the
        last one came.
        """
        autopilot = world.drone(role).autopilot
        last_ns = None
        if math.isfinite(autopilot.newest_setpoint_s):
            last_ns = self._epoch_ns + round(autopilot.newest_setpoint_s * 1e9)
        record = {"role": role.value, "gap_s": autopilot.setpoint_gap_s, "last_ns": last_ns}
        self._log.write("/setpoint_gap", self._epoch_ns + round(world.time_s * 1e9), record)

    def violation(
        self,
        time_s: float,
        monitor: str,
        detail: str,
    ) -> None:
        self._log.write(
            "/violation",
            self._epoch_ns + round(time_s * 1e9),
            {"monitor": monitor, "detail": detail},
        )


def _mount(own: RoleRig) -> dict[str, Any]:
    return {"T_b_c": _pose(own.mount.T_b_c), "T_b_v": _pose(own.mount.T_b_v)}


def _pose(pose: Pose) -> dict[str, Any]:
    return {"t": pose.t.tolist(), "q": quat_from_R(pose.R)}
