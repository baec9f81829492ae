"""Every object that D1 sees before it has a target: where each is, how it moves, and where it was.

Each is tracked with a constant-velocity filter, and every detection has the covariance that it has
where it is: across the line of sight that of an attitude and a pixel, along it that of its depth,
or of where its ray meets the ground. Far off, two that go one beside the other are told apart by
the one, however little the other says.

Detections are given to tracks one to one, the surest first. Whose history a track tells is known
only as long as nothing else could have been in its place: where detections could have been given
otherwise, nearly as likely, the histories of all that compete begin anew. One that is out of sight
is not forgotten for a while: it may be the one that is meant. What then comes to where it can be is
taken for it, anew.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from drivers.interfaces import View
from flight.guidance import Vec3, add, scale, subtract
from flight.tracking.objects import CUT_SCORE, MIN_SCORE, is_cut
from flight.tracking.places import at_height, place
from flight.tracking.ranging import COARSE
from path.belief.motion import Array, Motion, along_ray, mahalanobis2
from path.camera.model import CameraModel
from path.config import MethodConfig
from path.geometry.transforms import Pose
from path.observations import Box, Depth, Region

GATE_SIGMAS = 4.0
REMEMBERED_S = 20.0  # where something was, and that there was something
COASTED_S = 0.6  # unseen for longer, what comes to its place may be another one
STEADY_FRAMES = 5  # detectors invent things for a frame
# twice the logarithm of how much: a way to give detections to tracks is the right one
LIKELIER = 9.0
# of a box's larger side: how far from the object's middle its place is taken, from frame to frame
_ON_BODY = 0.1
_LEVEL_MPS = 0.02  # of what moves along the ground: how much it climbs
_CUT = 0.5  # the same, of a box that the border cuts


@dataclass(slots=True)
class Observed:
    """A detection in the local frame. ``depth`` is None where only its line of sight is known, or
    the border cuts it.

    ``covariance_m2``: of the place, shape (3, 3).
    """

    box: Box
    depth: Depth | None
    place_n_m: Vec3
    covariance_m2: Array


@dataclass(slots=True)
class Candidate:
    """One object.

    Attributes:
        number: its own, never given again.
        since_ns: from when on it is known to be one and the same.
        stamp_ns: when it was seen last; ``observed``: as what.
        frames: in how many frames it was seen since then.
    """

    number: int
    since_ns: int
    stamp_ns: int
    observed: Observed
    motion: Motion
    frames: int = 1
    path: deque[tuple[int, Vec3]] = field(default_factory=deque[tuple[int, Vec3]])

    @property
    def position_n_m(self) -> Vec3:
        """Return where it was when it was seen last."""
        return _vec3(self.motion.mean[:3])

    @property
    def velocity_n_mps(self) -> Vec3:
        """Return how it moved then."""
        return _vec3(self.motion.mean[3:])

    @property
    def vv(self) -> float:
        """Return the variance of its velocity along the ground, per axis."""
        return 0.5 * float(self.motion.covariance[3, 3] + self.motion.covariance[4, 4])

    def predicted(self, stamp_ns: int, accel_mps2: float) -> tuple[Vec3, float]:
        """Return its place at a stamp, and the standard deviation of that along the ground, per
        axis.
        """
        motion = self.motion.ahead(stamp_ns, accel_mps2)
        return _vec3(motion.place_m), motion.level_sigma_m

    def likely_velocity_n_mps(self, fastest_mps: float) -> Vec3:
        """Return its velocity as far as it is known, along each axis: nothing of where it may as
        well stand.

        Before anything is measured it is normal with half of the fastest speed for a standard
        deviation.
        """
        usual = np.eye(3) * (0.5 * fastest_mps) ** 2
        return _vec3(
            usual @ np.linalg.solve(usual + self.motion.covariance[3:, 3:], self.motion.mean[3:])
        )

    def unknown_s(self, stamp_ns: int) -> float:
        """Return how long a stamp is before or after all that is known of it; 0 within."""
        before_ns = self.since_ns - stamp_ns
        after_ns = stamp_ns - self.stamp_ns
        return max(0.0, before_ns * 1e-9, after_ns * 1e-9 - COASTED_S)

    def at(self, stamp_ns: int) -> Vec3:
        """Return where it was at a stamp; before and after all that is known, where it was first
        and last.
        """
        stamps = [stamp for stamp, _ in self.path]
        k = bisect_left(stamps, stamp_ns)
        if k == len(stamps):
            since_s = (stamp_ns - self.stamp_ns) * 1e-9
            return add(self.position_n_m, scale(self.velocity_n_mps, min(since_s, COASTED_S)))
        if k == 0:
            return self.path[0][1]
        (before_ns, before), (after_ns, after) = self.path[k - 1], self.path[k]
        share = (stamp_ns - before_ns) / max(1, after_ns - before_ns)
        return add(before, scale(subtract(after, before), share))

    def begin_anew(self) -> None:
        """Forget what it was: from now on it may be another one than before."""
        newest = self.path[-1]
        self.path.clear()
        self.path.append(newest)
        self.since_ns = newest[0]
        self.frames = 1

    def fuse(self, seen: Observed, stamp_ns: int, accel_mps2: float, *, level: bool) -> None:
        """Take a detection for it. ``level``: it moves neither up nor down."""
        self.motion.advance(stamp_ns, accel_mps2)
        self.motion.update(np.asarray(seen.place_n_m), seen.covariance_m2)
        if level:
            self._keep_level()
        self.stamp_ns = stamp_ns
        self.observed = seen
        self.frames += 1
        self.path.append((stamp_ns, self.position_n_m))
        while stamp_ns - self.path[0][0] > REMEMBERED_S * 1e9:
            self.path.popleft()

    def _keep_level(self) -> None:
        """Take its climb to be none: what depth errs along the line of sight is then no motion
        along the ground.
        """
        motion = self.motion
        gain = motion.covariance[:, 5] / (float(motion.covariance[5, 5]) + _LEVEL_MPS**2)
        motion.mean = motion.mean - gain * motion.mean[5]
        motion.covariance = motion.covariance - np.outer(gain, motion.covariance[5, :])


class Candidates:
    """All objects in view, from frame to frame.

    Args:
        attitude_sigma_rad: of the drone's roll and pitch, by which a line of sight errs.
        fastest_mps, accel_mps2: the most that one of them may do. flies: up and down too.
    """

    def __init__(
        self,
        camera: CameraModel,
        method: MethodConfig,
        attitude_sigma_rad: float,
        fastest_mps: float,
        accel_mps2: float,
        *,
        flies: bool,
    ) -> None:
        self._camera = camera
        self._angle_rad = math.hypot(attitude_sigma_rad, method.pixel_sigma_px / camera.fx)
        self._fastest_mps = fastest_mps
        self._accel_mps2 = accel_mps2
        self._level = not flies
        self._side_m = max(method.evidence.span_m, method.evidence.height_m)
        self._numbers = 0
        self.all: list[Candidate] = []

    def look(self, view: View, T_n_c: Pose, down_m: float) -> list[Candidate]:
        """Take up one frame; return the objects that are in it.

        Args:
            down_m: height of the object that is looked for, on which a line of sight without depth
                ends.
        """
        stamp_ns = view.stamp_ns
        self.all = [
            each for each in self.all if stamp_ns - each.stamp_ns <= self._kept_s(each) * 1e9
        ]
        seen = self._observed(view, T_n_c, down_m)
        costs = self._within_gates(seen, stamp_ns)
        given: dict[int, int] = {}
        for track, detection in sorted(costs, key=costs.__getitem__):
            if track not in given and detection not in given.values():
                given[track] = detection
        for track in competing(costs, given):
            self.all[track].begin_anew()
        for track, detection in given.items():
            self.all[track].fuse(seen[detection], stamp_ns, self._accel_mps2, level=self._level)
        for k in sorted(set(range(len(seen))) - set(given.values())):
            back = self._back(seen[k], stamp_ns)
            if back is None:
                self._begin(seen[k], stamp_ns)
            else:
                self._begin_again(back, seen[k], stamp_ns)
        return [each for each in self.all if each.stamp_ns == stamp_ns]

    def _observed(self, view: View, T_n_c: Pose, down_m: float) -> list[Observed]:
        found: list[Observed] = []
        for detection in view.targets(self._everywhere(T_n_c, down_m)):
            box = detection.box
            cut = is_cut(box, self._camera)
            if detection.score < (CUT_SCORE if cut else MIN_SCORE):
                continue
            depth = None if cut else view.depth(box)
            if depth is None:
                there = at_height(box.center, self._camera, T_n_c, down_m)
            else:
                there = place(box, depth, self._camera, T_n_c, down_m)
            if there is not None:
                found.append(
                    Observed(box, depth, there, self._covariance(box, depth, cut, there, T_n_c))
                )
        return found

    def _everywhere(self, T_n_c: Pose, down_m: float) -> Region | None:
        """Return all of the image, and how large the target is where the camera looks; None where
        that is not known.
        """
        camera = self._camera
        seen = at_height((camera.cx, camera.cy), camera, T_n_c, down_m)
        if seen is None or self._side_m <= 0.0:
            return None
        _, _, z_m = T_n_c.inverse().apply(np.array(seen)).tolist()
        side_px = self._side_m * camera.fx / max(z_m, self._side_m)
        return Region(0.0, 0.0, float(camera.width), float(camera.height), side_px=side_px)

    def _covariance(
        self, box: Box, depth: Depth | None, cut: bool, there: Vec3, T_n_c: Pose
    ) -> Array:
        """Return the covariance (3, 3) of a place: across its line of sight, along it, and on the
        body.
        """
        ray = np.asarray(there) - T_n_c.t
        range_m = float(np.linalg.norm(ray))
        ray /= max(range_m, 1e-9)
        across_m = self._angle_rad * range_m
        # where a ray that errs so much meets the ground
        on_ground_m = across_m / max(abs(float(ray[2])), 1e-3)
        along_m = (
            on_ground_m
            if depth is None
            else min(depth.sigma_m, max(on_ground_m, COARSE * depth.z_m))
        )
        side_px = float(max(box.w, box.h))  # detectors say float32
        on_body_m = (_CUT if cut else _ON_BODY) * side_px / self._camera.fx * range_m
        return along_ray(ray, across_m**2 + on_body_m**2, along_m**2)

    def _within_gates(
        self, seen: Sequence[Observed], stamp_ns: int
    ) -> dict[tuple[int, int], float]:
        """Every track and detection that may be the same object, with minus twice the log
        likelihood that they are.
        """
        costs: dict[tuple[int, int], float] = {}
        for t, track in enumerate(self.all):
            if stamp_ns - track.stamp_ns > COASTED_S * 1e9:
                continue
            expected = track.motion.ahead(stamp_ns, self._accel_mps2)
            known_m2 = expected.place_covariance_m2
            for d, one in enumerate(seen):
                off_m = np.asarray(one.place_n_m) - expected.place_m
                off2, determinant = mahalanobis2(off_m, known_m2, one.covariance_m2)
                if off2 <= GATE_SIGMAS**2:
                    costs[t, d] = off2 + math.log(determinant)
        return costs

    def _kept_s(self, one: Candidate) -> float:
        return REMEMBERED_S if one.frames >= STEADY_FRAMES else COASTED_S

    def _back(self, seen: Observed, stamp_ns: int) -> Candidate | None:
        """The nearest of those out of sight that can have come there; None when none can."""
        nearest: Candidate | None = None
        nearest_m = math.inf
        for one in self.all:
            unseen_s = (stamp_ns - one.stamp_ns) * 1e-9
            off = np.asarray(seen.place_n_m) - one.motion.place_m
            off_m = float(np.linalg.norm(off))
            way = off / max(off_m, 1e-9)
            unknown_m = math.sqrt(
                float(way @ (seen.covariance_m2 + one.observed.covariance_m2) @ way)
            )
            reach_m = self._fastest_mps * unseen_s + GATE_SIGMAS * unknown_m
            if unseen_s > COASTED_S and off_m <= min(reach_m, nearest_m):
                nearest = one
                nearest_m = off_m
        return nearest

    def _begin(self, seen: Observed, stamp_ns: int) -> None:
        self._numbers += 1
        one = Candidate(self._numbers, stamp_ns, stamp_ns, seen, self._motion_of(seen, stamp_ns))
        self._begin_again(one, seen, stamp_ns)
        self.all.append(one)

    def _begin_again(self, one: Candidate, seen: Observed, stamp_ns: int) -> None:
        one.since_ns = one.stamp_ns = stamp_ns
        one.observed, one.motion, one.frames = seen, self._motion_of(seen, stamp_ns), 1
        one.path.clear()
        one.path.append((stamp_ns, seen.place_n_m))

    def _motion_of(self, seen: Observed, stamp_ns: int) -> Motion:
        """Return the motion of what is seen for the first time: it may be as fast as such a thing
        can be.
        """
        motion = Motion.at(
            np.asarray(seen.place_n_m), seen.covariance_m2, self._accel_mps2, stamp_ns
        )
        motion.covariance[3:, 3:] = np.eye(3) * (0.5 * self._fastest_mps) ** 2
        return motion


def _vec3(of: Array) -> Vec3:
    x, y, z = of.tolist()
    return x, y, z


def competing(costs: Mapping[tuple[int, int], float], given: Mapping[int, int]) -> set[int]:
    """Return the tracks that may have been given another object's detection: another way to give is
    nearly as likely.

    Two may have changed places; one may be where a detection is that nobody was given; or it may be
    one that was given nothing, where another one was given something.

    Args:
        costs: of each track and detection that may be the same.
        given: the detection of each track.
    """
    taken_by = {detection: track for track, detection in given.items()}
    unsure: set[int] = set()
    for (track, detection), cost in costs.items():
        other = taken_by.get(detection)
        if other == track:
            continue
        own = given.get(track)
        more = cost
        if own is not None:
            more -= costs[track, own]
        if other is not None:
            more -= costs[other, detection]
        if own is not None and other is not None:
            more += costs.get((other, own), math.inf)
        if more < LIKELIER:
            unsure |= {each for each in (track, other) if each is not None}
    return unsure
