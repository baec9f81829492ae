"""The truth of a run, from the world's log, at any instant of a role's clock."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from drivers.log.mcap_log import LogRecord
from missions.look.report.records import Records, RunRecords, first, judged_pairs, last
from path.arrays import Array, Whole
from path.camera.model import CameraModel
from path.geometry.rotation import R_from_quat, R_from_yaw
from path.geometry.transforms import Pose, Vector
from path.messages import Role
from path.values import frozen


@frozen
class TrueScene:
    """The constants of a world: see ``/scene`` in ``missions.look.report.records``."""

    target_id: int
    min_separation_m: float
    boxes: Array  # (n, 6): centre and size, in the frame of an object
    clock_offset_ns: Mapping[Role, int]
    cameras: Mapping[Role, CameraModel]
    T_b_c: Mapping[Role, Pose]
    T_b_v: Pose

    @property
    def middle_o(self) -> Vector:
        """The middle of an object, in its frame."""
        half = self.boxes[:, 3:] / 2
        return ((self.boxes[:, :3] - half).min(axis=0) + (self.boxes[:, :3] + half).max(axis=0)) / 2


class Truth:
    """Interpolates ``/truth``. Instants are of the clock of the role that is named with them."""

    def __init__(self, scene: TrueScene, records: Sequence[LogRecord]) -> None:
        self.scene = scene
        self.stamps_ns = np.array([r.stamp_ns for r in records], np.int64)
        # interpolation is relative to the start: float64 has no room for nanoseconds since some
        # epoch
        self._start_ns = int(self.stamps_ns[0])
        self._since_ns = self.stamps_ns - self._start_ns
        self._t = {
            role: np.array([r.record[role.value]["t"] for r in records], float) for role in Role
        }
        self._q = {role: _continuous([r.record[role.value]["q"] for r in records]) for role in Role}
        self._in_air = {
            role: np.array([r.record[role.value]["in_air"] for r in records], bool) for role in Role
        }
        self._objects = _objects([r.record["objects"] for r in records])
        self.object_ids = sorted(self._objects)

    @property
    def separation_m(self) -> Array:
        """Between the two bodies, one for each of ``stamps_ns``; NaN unless both are in the air."""
        apart = np.linalg.norm(self._t[Role.SENDER] - self._t[Role.RECEIVER], axis=1)
        return np.where(self._in_air[Role.SENDER] & self._in_air[Role.RECEIVER], apart, np.nan)

    def way_to(self, role: Role, object_id: int) -> tuple[Whole, Array]:
        """Return the stamps of the world's clock, and from a role's body to an object at each:
        east, north, up.
        """
        return self.stamps_ns, self._objects[object_id][:, :3] - self._t[role]

    def to_world_ns(self, role: Role, stamp_ns: int) -> int:
        return stamp_ns - self.scene.clock_offset_ns[role]

    def T_w_c(self, role: Role, stamp_ns: int) -> Pose:
        """A role's camera in the world."""
        return self.T_w_b(role, role, stamp_ns) @ self.scene.T_b_c[role]

    def T_v_c2(self, stamp_ns: int) -> Pose:
        """The receiver's camera in the marker's frame; stamp of the receiver's clock."""
        T_w_v = self.T_w_b(Role.SENDER, Role.RECEIVER, stamp_ns) @ self.scene.T_b_v
        return T_w_v.inverse() @ self.T_w_c(Role.RECEIVER, stamp_ns)

    def T_w_o(
        self,
        object_id: int,
        role: Role,
        stamp_ns: int,
    ) -> Pose:
        """An object in the world."""
        x, y, z, yaw = self._at(self._objects[object_id], role, stamp_ns)
        return Pose(R_from_yaw(yaw), np.array([x, y, z]))

    def hit_o(
        self,
        role: Role,
        stamp_ns: int,
        pixel: Sequence[float],
        object_id: int,
    ) -> Vector | None:
        """Return where the ray of a pixel meets an object, in the object's frame; None when it
        misses.
        """
        x, y = self.scene.cameras[role].ray(pixel[0], pixel[1])
        T_o_c = self.T_w_o(object_id, role, stamp_ns).inverse() @ self.T_w_c(role, stamp_ns)
        return first_hit(T_o_c.t, T_o_c.R @ np.array([x, y, 1.0]), self.scene.boxes)

    def object_at(
        self,
        role: Role,
        stamp_ns: int,
        pixel: Sequence[float],
    ) -> int:
        """The object whose middle is seen nearest to a pixel, of those that are there at that
        instant.
        """
        T_c_w = self.T_w_c(role, stamp_ns).inverse()

        def distance_px(object_id: int) -> float:
            middle_c = T_c_w.apply(self.T_w_o(object_id, role, stamp_ns).apply(self.scene.middle_o))
            if not middle_c[2] > 0.0:
                return math.inf
            u, v = self.scene.cameras[role].project_point((middle_c[0], middle_c[1], middle_c[2]))
            return math.dist((u, v), (pixel[0], pixel[1]))

        return min(self.object_ids, key=distance_px)

    def T_w_b(
        self,
        body: Role,
        clock: Role,
        stamp_ns: int,
    ) -> Pose:
        w, x, y, z = self._at(self._q[body], clock, stamp_ns)
        norm = math.sqrt(w * w + x * x + y * y + z * z)
        R = R_from_quat((w / norm, x / norm, y / norm, z / norm))
        return Pose(R, np.array(self._at(self._t[body], clock, stamp_ns)))

    def _at(
        self,
        values: Array,
        clock: Role,
        stamp_ns: int,
    ) -> list[float]:
        """Values of shape (n, k), interpolated."""
        instant = self.to_world_ns(clock, stamp_ns) - self._start_ns
        k = min(max(int(self._since_ns.searchsorted(instant)), 1), len(self._since_ns) - 1)
        before = int(self._since_ns[k - 1])
        after = int(self._since_ns[k])
        share = (instant - before) / (after - before)
        return (values[k - 1] + share * (values[k] - values[k - 1])).tolist()


def _objects(records: Sequence[Sequence[Mapping[str, Any]]]) -> dict[int, Array]:
    """(x, y, z, yaw) of every object by id, shape (n, 4), NaN while it is not there: look-alikes
    come and go.
    """
    found: dict[int, Array] = {}
    for k, objects in enumerate(records):
        for each in objects:
            found.setdefault(each["id"], np.full((len(records), 4), np.nan))[k] = (
                *each["t"],
                each["yaw"],
            )
    for poses in found.values():
        there = np.isfinite(poses[:, 3])
        poses[there, 3] = np.unwrap(poses[there, 3])
    return found


def truth_of(world: Records) -> Truth | None:
    """The truth in a world's log; None when there is none."""
    scene = first(world, "/scene")
    records = world.get("/truth", ())
    if scene is None or len(records) < 2:
        return None
    return Truth(_scene(scene), records)


def handed_over(run: RunRecords, truth: Truth) -> int | None:
    """The object, in truth, in D2's box of the last pair that agreed before the commit; None
    without a commit.
    """
    if last(run.sender, "/commit") is None:
        return None
    answers = {r.record["sequence"]: r.record for r in run.receiver.get("/candidate", ())}
    for pair in reversed(judged_pairs(run)):
        answer = answers.get(pair.record["sequence"])
        if pair.record["agreed"] and answer is not None and answer["box"] is not None:
            return truth.object_at(Role.RECEIVER, answer["capture_ns"], box_center(answer["box"]))
    return None


def box_center(box: Sequence[float]) -> tuple[float, float]:
    x, y, w, h = box
    return x + w / 2.0, y + h / 2.0


def first_hit(
    origin: Vector,
    direction: Vector,
    boxes: Array,
) -> Vector | None:
    """Return where a ray first enters one of the boxes (n, 6: centre, size; axes-aligned); None
    when it misses all.
    """
    direction = np.where(np.abs(direction) < 1e-12, 1e-12, direction)
    near = (boxes[:, :3] - boxes[:, 3:] / 2 - origin) / direction
    far = (boxes[:, :3] + boxes[:, 3:] / 2 - origin) / direction
    enter = np.minimum(near, far).max(axis=1)
    leave = np.maximum(near, far).min(axis=1)
    hits = enter[(enter <= leave) & (enter > 0.0)]
    return origin + hits.min() * direction if len(hits) else None


def _continuous(quaternions: Sequence[Sequence[float]]) -> Array:
    """Signs such that neighbours are near each other."""
    q = np.array(quaternions, float)
    flips = np.where(np.sum(q[1:] * q[:-1], axis=1) < 0.0, -1.0, 1.0)
    q[1:] *= np.cumprod(flips)[:, None]
    return q


def _scene(record: Mapping[str, Any]) -> TrueScene:
    return TrueScene(
        target_id=record["target_id"],
        min_separation_m=record["min_separation_m"],
        boxes=np.array([[*box["c"], *box["s"]] for box in record["boxes"]], float),
        clock_offset_ns={role: record["clock_offset_ns"].get(role.value, 0) for role in Role},
        cameras={role: _camera(record["cameras"][role.value]) for role in Role},
        T_b_c={role: _pose(record["mounts"][role.value]["T_b_c"]) for role in Role},
        T_b_v=_pose(record["mounts"][Role.SENDER.value]["T_b_v"]),
    )


def _camera(record: Mapping[str, Any]) -> CameraModel:
    k1, k2, p1, p2, k3 = record["distortion"]
    return CameraModel(
        record["width"],
        record["height"],
        record["fx"],
        record["fy"],
        record["cx"],
        record["cy"],
        (k1, k2, p1, p2, k3),
    )


def _pose(record: Mapping[str, Any]) -> Pose:
    w, x, y, z = record["q"]
    return Pose(R_from_quat((w, x, y, z)), np.array(record["t"], float))
