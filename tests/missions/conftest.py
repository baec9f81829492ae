"""A run folder as two drones would leave it, with errors of known size in it."""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.log.mcap_log import McapLog
from missions.look.report.records import RECEIVER_LOG, SENDER_LOG, WORLD_LOG, RunFacts, write_facts
from path.camera.model import CameraModel
from path.geometry.rotation import quat_from_R
from path.geometry.transforms import Pose
from path.messages import Role

CAMERA = CameraModel(640, 480, 615.0, 615.0, 319.5, 239.5, (0.1, -0.2, 0.001, 0.001, 0.05))
BOXES = np.array([[0.0, 0.0, 0.07, 0.32, 0.16, 0.07], [-0.03, 0.0, 0.133, 0.16, 0.14, 0.054]])
PERIOD_NS = 20_000_000
VERIFY_S, PAIRS, FRAMES = 20.0, 350, 600


def _facing(position: tuple[float, float, float], at: tuple[float, float, float]) -> Pose:
    """A camera in the world, its x axis level."""
    z = np.subtract(at, position)
    z /= np.linalg.norm(z)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    return Pose(np.stack([x, np.cross(z, x), z], axis=1), np.array(position, float))


def _pose(pose: Pose) -> dict[str, Any]:
    return {"t": pose.t.tolist(), "q": list(quat_from_R(pose.R))}


@cache
def _hit_o(eye_o: tuple[float, ...]) -> np.ndarray[Any, Any]:
    """Returns where the line from ``eye_o`` to the middle of an object enters it, found by walking
    along it.
    """
    steps = np.linspace(0.8, 1.0, 10_001)[:, None]
    points = np.array(eye_o) + steps * (np.array([0.0, 0.0, 0.08]) - eye_o)
    inside = [np.all(np.abs(points - box[:3]) <= box[3:] / 2, axis=1) for box in BOXES]
    return points[int(np.argmax(np.any(inside, axis=0)))]


@dataclass(frozen=True)
class Synthetic:
    """A run with chosen errors, with or without a commit and a world.

    ``clock_offset_s`` sets the roles' clocks apart from the world's, by a different amount each.
    """

    d2_error_m: float = 0.005
    target_error_m: float = 0.008
    committed: bool = True
    world: bool = True
    images: bool = False
    followed_id: int = 0  # the object that D2's boxes are of
    clock_offset_s: float = 100.0

    def write(self, folder: Path) -> None:
        for name, fill in (
            (SENDER_LOG, self._sender),
            (RECEIVER_LOG, self._receiver),
            (WORLD_LOG, self._world),
        ):
            if name != WORLD_LOG or self.world:
                with McapLog(folder / name) as log:
                    fill(log)
                    assert log.failed is None
        label, code = ("committed", 0) if self.committed else ("no_agreement", 10)
        write_facts(
            folder,
            RunFacts("sim", "sim", 7, label, code, simulated_s=40.0, wall_s=0.5, violations={}),
        )

    # --- truth: D1 flies east at 0.3 m/s beside the target, D2 behind D1

    def T_w_o(self, time_s: float, object_id: int = 0) -> Pose:
        return Pose(np.eye(3), np.array([0.3 * time_s, 4.0 + 1.3 * object_id, 0.0]))

    def T_w_c(self, role: Role, time_s: float) -> Pose:
        x = 0.3 * time_s
        # low enough for the middle of the target to be seen on its side, whatever the frame
        if role is Role.SENDER:
            return _facing((x, 2.5, 1.4), (x, 4.0, 0.08))
        return _facing((x - 0.5, 1.6, 1.9), (x, 3.6, 0.5))

    def T_v_c2(self, time_s: float) -> Pose:
        return self.T_w_v(time_s).inverse() @ self.T_w_c(Role.RECEIVER, time_s)

    def T_w_v(self, time_s: float) -> Pose:
        backward = np.array(
            [
                [1.0, 0.0, 0.0],
                [0.0, math.sqrt(0.5), -math.sqrt(0.5)],
                [0.0, math.sqrt(0.5), math.sqrt(0.5)],
            ]
        )
        return Pose(backward, self.T_w_c(Role.SENDER, time_s).t + np.array([0.0, -0.25, 0.05]))

    def _seen(self, role: Role, time_s: float, object_id: int, size_px: float) -> list[float]:
        middle = self.T_w_o(time_s, object_id).apply(np.array([0.0, 0.0, 0.08]))
        x, y, z = self.T_w_c(role, time_s).inverse().apply(middle)
        u, v = CAMERA.project_point((x, y, z))
        return [u - size_px / 2, v - size_px / 3, size_px, size_px / 1.5]

    def _hit_w(self, time_s: float) -> np.ndarray[Any, Any]:
        """Returns where D1's line of sight through its box centre meets the target: always the same
        place.
        """
        eye_o = self.T_w_o(0.0).inverse().apply(self.T_w_c(Role.SENDER, 0.0).t)
        return self.T_w_o(time_s).apply(_hit_o(tuple(eye_o.tolist())))

    # --- logs

    def _stamp(self, role: Role, time_s: float) -> int:
        offset_s = self.clock_offset_s * (1.0 if role is Role.SENDER else 2.5)
        return round((time_s + offset_s) * 1e9)

    def _common(self, log: McapLog, role: Role, phases: list[tuple[float, str]]) -> None:
        for time_s, phase in phases:
            log.write("/phase", self._stamp(role, time_s), {"phase": phase, "note": ""})
        for second in range(15, 36):
            sent = 4000 * second + (400 if role is Role.SENDER else 0)
            record = {
                "bytes_sent": sent,
                "bytes_received": 0,
                "packets_sent": 0,
                "packets_received": 0,
            }
            log.write(
                "/link", self._stamp(role, second), {**record, "dropped": {}, "clock_offset_ns": 0}
            )

    def _image(self, log: McapLog, role: Role, time_s: float) -> None:
        image = np.full((CAMERA.height, CAMERA.width, 3), 110, np.uint8)
        for object_id in (0, 1):
            x, y, w, h = (round(value) for value in self._seen(role, time_s, object_id, 80.0))
            image[max(y, 0) : y + h, max(x, 0) : x + w] = (24, 118, 245)
        log.image("/image", self._stamp(role, time_s), image)

    def _sender(self, log: McapLog) -> None:
        role = Role.SENDER
        end_s = VERIFY_S + PAIRS * 0.02
        self._common(
            log,
            role,
            [
                (0, "preflight"),
                (5, "take-off"),
                (10, "follow"),
                (VERIFY_S, "verify"),
                (end_s, "depart"),
            ],
        )
        for k in range(FRAMES):
            time_s = VERIFY_S - 1.0 + 0.02 * k
            # one frame was missed
            log.write("/frame", self._stamp(role, time_s), {"frame_id": k + (k > 100)})
            stamp_ns = self._stamp(role, time_s)
            target = {
                "sequence": k,
                "capture_ns": stamp_ns,
                "box": self._seen(role, time_s, 0, 90.0),
                "reason": None,
            }
            log.write("/target", stamp_ns, target)
        for k in range(PAIRS + 2):
            agreed = k > 1
            time_s = VERIFY_S + 0.02 * k
            record = {
                "agreed": agreed,
                "counted": True,
                "reason": None if agreed else "low_iou",
                "iou": 0.7 if agreed else 0.1,
                "tau": 0.3,
                "count": max(0, k - 1),
                "needed": PAIRS,
                "evidence": None,
                "evidence_needed": None,
                "capture_ns": self._stamp(role, time_s),
                "sequence": k,
                "target_sequence": 50 + k,
                "target_id": 1,
                "epoch": 1,
                "own_box": self._seen(role, time_s, 0, 90.0),
                "mapped_box": self._seen(role, time_s, 0, 80.0),
            }
            log.write("/agreement", self._stamp(role, time_s) + 1_000_000, record)
        if self.images:
            self._image(log, role, end_s - 0.3)
        log.write(
            "/responsibility", self._stamp(role, 10.0), {"responsible": True, "until_ns": None}
        )
        if self.committed:
            log.write(
                "/responsibility",
                self._stamp(role, end_s + 0.04),
                {"responsible": False, "until_ns": None},
            )
            log.write("/commit", self._stamp(role, end_s + 0.05), {"target_id": 1, "epoch": 1})
        outcome = {
            "outcome": "committed" if self.committed else "no_agreement",
            "detail": "",
            "landed": True,
        }
        log.write(
            "/outcome", self._stamp(role, 35.0), {**outcome, "responsible": not self.committed}
        )

    def _receiver(self, log: McapLog) -> None:
        role = Role.RECEIVER
        end_s = VERIFY_S + PAIRS * 0.02
        phases = [
            (0.0, "preflight"),
            (6.0, "take-off"),
            (11.0, "stand-off"),
            (14.0, "search"),
            (15.0, "approach"),
        ]
        self._common(log, role, [*phases, (19.0, "verify"), (end_s, "follow"), (33.0, "land")])
        for k in range(FRAMES - 48):
            time_s = VERIFY_S + 0.02 * k
            stamp_ns = self._stamp(role, time_s)
            log.write("/frame", stamp_ns, {"frame_id": k})
            if k < PAIRS + 2:
                log.write("/marker", stamp_ns, self._marker(stamp_ns, time_s))
                log.write("/candidate", stamp_ns, self._candidate(k, stamp_ns, time_s))
        if self.committed:
            log.write(
                "/responsibility",
                self._stamp(role, end_s + 0.1),
                {"responsible": True, "until_ns": None},
            )
        if self.images:
            self._image(log, role, end_s - 0.4)

    def _marker(self, stamp_ns: int, time_s: float) -> dict[str, Any]:
        half = 0.02
        corners_v = np.array(
            [[-half, half, 0], [half, half, 0], [half, -half, 0], [-half, -half, 0]]
        )
        corners_c = self.T_v_c2(time_s).inverse().apply(corners_v)
        pose = self.T_v_c2(time_s)
        return {
            "capture_ns": stamp_ns,
            "position_v_m": pose.t.tolist(),
            "rotation_v_c2": list(quat_from_R(pose.R)),
            "sigma_m": 0.01,
            "side_px": 24.0,
            "corners_px": CAMERA.project(corners_c).ravel().tolist(),
            "reason": None,
        }

    def _candidate(self, k: int, stamp_ns: int, time_s: float) -> dict[str, Any]:
        pose = self.T_v_c2(time_s)
        estimated = Pose(pose.R, pose.t + np.array([0.0, 0.0, self.d2_error_m]))
        # the point as D2 has it: right in its own camera frame, but for the error
        point_c2 = self.T_w_c(Role.RECEIVER, time_s).inverse().apply(self._hit_w(time_s))
        point_c2 = point_c2 + np.array([self.target_error_m, 0.0, 0.0])
        x, y, w, h = self._seen(Role.RECEIVER, time_s, 0, 70.0)
        return {
            "sequence": k,
            "target_sequence": 50 + k,
            "capture_ns": stamp_ns,
            "box": self._seen(Role.RECEIVER, time_s, self.followed_id, 70.0),
            "reason": None,
            "position_v_m": estimated.t.tolist(),
            "rotation_v_c2": list(quat_from_R(estimated.R)),
            "sigma_m": 0.01,
            "point_v_m": estimated.apply(point_c2).tolist(),
            "prior_px": [x + w / 2 + 3, y + h / 2 - 2],
            "region": [x - 30, y - 30, x + w + 30, y + h + 30],
        }

    def _world(self, log: McapLog) -> None:
        camera = {
            name: getattr(CAMERA, name)
            for name in ("width", "height", "fx", "fy", "cx", "cy", "distortion")
        }
        # bodies are the cameras themselves, D1's with the marker where it is in truth
        unit = _pose(Pose(np.eye(3), np.zeros(3)))
        marker = _pose(self.T_w_c(Role.SENDER, 0.0).inverse() @ self.T_w_v(0.0))
        scene = {
            "target_id": 0,
            "min_separation_m": 0.7,
            "boxes": [{"c": box[:3], "s": box[3:]} for box in BOXES],
            "clock_offset_ns": {role.value: self._stamp(role, 0.0) for role in Role},
            "cameras": {role.value: camera for role in Role},
            "mounts": {role.value: {"T_b_c": unit, "T_b_v": marker} for role in Role},
        }
        log.write("/scene", 0, scene)
        for k in range(round(36.0 / 0.05)):
            time_s = 0.05 * k
            objects = [{"id": i, "t": self.T_w_o(time_s, i).t.tolist(), "yaw": 0.0} for i in (0, 1)]
            bodies = {
                r.value: {**_pose(self.T_w_c(r, time_s)), "in_air": 5.0 < time_s < 33.0}
                for r in Role
            }
            log.write("/truth", round(time_s * 1e9), {**bodies, "objects": objects})
        log.write("/setpoint_gap", 0, {"role": "sender", "gap_s": 0.04})


MakeRun = Callable[..., Path]


@pytest.fixture(scope="session")
def written_runs() -> dict[Synthetic, Path]:
    return {}


@pytest.fixture
def make_run(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, written_runs: dict[Synthetic, Path]
) -> MakeRun:
    """Gives a run folder of the test's own; takes the fields of ``Synthetic``."""

    def make(**changes: Any) -> Path:
        run = replace(Synthetic(), **changes)
        if run not in written_runs:
            folder = tmp_path_factory.mktemp("run")
            run.write(folder)
            written_runs[run] = folder
        return shutil.copytree(written_runs[run], tmp_path / "run")

    return make
