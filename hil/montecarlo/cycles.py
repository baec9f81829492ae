"""Both drones' cycles of one Monte-Carlo hand-over, and a record of what D1's window was given.

``MarkerView``, ``ReceiverSide`` and ``SenderSide`` are the flight's own. They are given frames and
messages in the order of time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from drivers.rig.parts import Mount
from flight.frame.receiver import ReceiverSide
from flight.frame.records import AttemptId
from flight.frame.sender import PairCameras, SenderSide
from flight.harness.montecarlo import MISS, OWN_MISS, PAIR, Attempt, Series
from flight.rendezvous.marker_view import MarkerFix, MarkerView, VehicleMotions
from flight.tracking.association import Sighting
from hil.montecarlo.follower import TARGET
from hil.montecarlo.scene import Believed
from hil.montecarlo.setup import (
    BLOCK_S,
    CANDIDATE_HEARD,
    EPOCH_S,
    RECEIVER_FRAME,
    SENDER_FRAME,
    HandoverSetup,
)
from path.arrays import Array
from path.config import BoxMapping, MethodConfig
from path.cycle.prior import Prior
from path.cycle.sender import PairVerdict
from path.gate.agreement import Agreed, TwoViews, depth_in, iou, map_box
from path.gate.window import AgreementWindow, Offsets
from path.geometry.rigid import rigid, rigid_from_quat
from path.geometry.rotation import normalized
from path.geometry.transforms import Pose
from path.messages import Candidate, Target, Vec3
from path.observations import Box, MissReason
from path.values import frozen

REASONS = tuple(MissReason)
SLACK_NS = 500_000_000  # what was captured is judged later, by the link and both cycles
BOTH: tuple[BoxMapping, BoxMapping] = ("center", "corner")


@frozen
class CyclesRun:
    """The entries that D1's window was given, and the time that was run.

    Attributes:
        decided: how many entries there were when the window had nothing more to decide.
        done: the pair with which it was complete for the first time; None when it never was.
    """

    series: Series
    decided: int
    done: int | None
    simulated_s: float


def run_cycles(
    attempt: Attempt,
    setup: HandoverSetup,
    believed: Believed,
    method: MethodConfig,
    until: Callable[[Series], bool] | None = None,
) -> CyclesRun:
    """Both cycles from the attempt's beginning until it is decided, or over.

    Args:
        until: asked some times a second with what the gate was told so far; True ends the attempt.
            Of one that is not ``whole`` it is asked once D1's window has decided.
    """
    cycles = _Cycles(setup, believed, method)
    kinds, which, now = setup.events
    events = list(zip(kinds.tolist(), which.tolist(), now.tolist(), strict=True))
    limit_ns = _ns(attempt.limit_s)
    until_s = 0.0
    first = 0
    step_s = 0.5 * BLOCK_S if attempt.whole else BLOCK_S
    counts = not attempt.whole
    decided = 0
    while first < len(events) and until_s < attempt.limit_s:
        until_s = min(until_s + step_s, attempt.limit_s)
        setup.reach(until_s)
        last = int(np.searchsorted(now, _ns(until_s)))
        first += cycles.run(events[first:last], counts)
        if counts and (cycles.done is not None or cycles.hopeless(_ns(until_s), limit_ns)):
            counts = False
            decided = len(cycles.record)
            if until is None or until(cycles.record.series):
                break
            first += cycles.run(events[first:last], counts)
        if not counts and until is not None and len(cycles.record) and until(cycles.record.series):
            break
    return CyclesRun(cycles.record.series, decided or len(cycles.record), cycles.done, until_s)


def _ns(time_s: float) -> int:
    return round((time_s + EPOCH_S) * 1e9)


class _Cycles:
    """Both drones in one attempt. ``done``: see ``CyclesRun``."""

    def __init__(
        self,
        setup: HandoverSetup,
        believed: Believed,
        method: MethodConfig,
    ) -> None:
        rig = setup.rig
        own = rig.sender.mount
        carried = Mount(rig.receiver.mount.T_b_c, rig.sender.mount.T_b_v)
        mount = own.T_b_v.inverse() @ own.T_b_c
        self._setup = setup
        camera_1 = rig.sender.camera
        camera_2 = rig.receiver.camera
        # the paper's gate decides when to stop; others are told the series afterwards
        method = replace(method, gate="count")
        self._marker = MarkerView(rig.layout, camera_2, carried, method, believed.mission)
        self._window = AgreementWindow(method)
        self._hold_ns = round(method.hold_s * 1e9)
        self._begin_ns = 0  # of the run under way
        cameras = PairCameras(camera_1, camera_2, mount)
        attempt = AttemptId(1, 1, 1)
        self._sender = SenderSide(cameras, method, attempt, gate=self._window)
        self._receiver = ReceiverSide(cameras, method, attempt)
        self._targets: dict[int, Target] = {}
        self._candidates: dict[int, Candidate] = {}
        self.record = _Record(TwoViews(camera_1, camera_2, rigid(mount)), method.box_mapping)
        self.done: int | None = None

    def run(self, events: Sequence[tuple[int, int, int]], to_done: bool) -> int:
        """Run these events in order, ``to_done`` up to the one that completes the window. Returns
        how many it ran.
        """
        setup = self._setup
        for many, (kind, which, now_ns) in enumerate(events, 1):
            if kind == SENDER_FRAME:
                self._sender_frame(which, now_ns)
                if self.done is None and self._window.complete:
                    self.done = self.record.agreed
                if self.done is not None and to_done:
                    return many
            elif kind == RECEIVER_FRAME:
                self._receiver_frame(which)
            elif kind == CANDIDATE_HEARD:
                candidate = self._candidates[which]
                self._sender.hear(candidate, candidate.capture_ns, now_ns)
            elif which in self._targets:
                self._receiver.hear(
                    self._targets[which],
                    int(setup.seen.stamp_1[which]),
                    now_ns + setup.clock_ns,
                )
        return len(events)

    def hopeless(self, now_ns: int, limit_ns: int) -> bool:
        """Return whether no run can be long enough before the limit: not even one that goes on, or
        begins now.
        """
        begin_ns = self._begin_ns if self._window.count else now_ns
        return begin_ns - SLACK_NS + self._hold_ns > limit_ns

    def _sender_frame(self, k: int, now_ns: int) -> None:
        seen = self._setup.seen
        stamp_ns = int(seen.stamp_1[k])
        number = int(seen.number_1[k])
        found, who = self._setup.followed(k)
        message = self._sender.observe(number, stamp_ns, found, _vector(seen.gravity_v[k])).message
        if isinstance(message, Target):
            self._targets[k] = message
            self.record.own_whose[number] = who
        else:
            self.record.own_miss(
                message.reason if isinstance(found, Sighting) else found,
                number,
                stamp_ns,
                now_ns,
            )
        for pair in self._sender.judge(now_ns):
            self.record.pair(pair, now_ns)
            if self._window.count == 1:
                self._begin_ns = pair.capture_ns

    def _receiver_frame(self, k: int) -> None:
        seen = self._setup.seen
        side = self._receiver
        stamp_ns = int(seen.stamp_2[k])
        number = int(seen.number_2[k])
        view = self._setup.receiver_view(k)
        self._marker.note_motion(self._motion(k, stamp_ns))
        gravity_v = side.gravity_v(stamp_ns)
        gravity_c = _vector(seen.gravity_c[k])
        fix = self._marker.look(view, seen.R_n_c[k], gravity_v, gravity_c)
        if isinstance(fix, MarkerFix):
            biased = Pose(seen.turn @ fix.T_c_v.R, fix.T_c_v.t + seen.shift_c)
            fix = replace(fix, T_c_v=biased)
        prior = side.prior(fix, stamp_ns)
        found = view.targets(prior.region) if isinstance(prior, Prior) else ()
        answer = side.answer(number, stamp_ns, found, prior)
        assert answer is not None
        candidate = answer.candidate
        self._candidates[k] = candidate
        if candidate.box is not None:
            self.record.whose[candidate.sequence] = view.whose(candidate.box)

    def _motion(self, k: int, stamp_ns: int) -> VehicleMotions:
        """Return D2's knowledge of both vehicles' motion by its frame."""
        seen = self._setup.seen
        last = int(seen.heard[k]) - 1
        peer = (
            int(seen.peer_stamp[last]),
            _vector(seen.peer_velocity[last]),
            float(seen.peer_yaw[last]),
        )
        return VehicleMotions(stamp_ns, _vector(seen.own_velocity[k]), *peer)


class _Record:
    """The gate's input as a series: scores are those of both mappings, whatever the verdict.

    ``whose``: object of D2's box by sequence; ``own_whose``: of D1's by frame.
    ``agreed``: the newest pair that the gate counted.
    """

    def __init__(self, views: TwoViews, mapping: BoxMapping) -> None:
        self.whose: dict[int, int] = {}
        self.own_whose: dict[int, int] = {}
        self.agreed: int | None = None
        self._views = views
        self._other: BoxMapping = BOTH[1 - BOTH.index(mapping)]
        self._rows: list[tuple[int, ...]] = []  # that are in no array yet
        self._values: list[tuple[float, ...]] = []
        self._ints, self._floats = np.empty((0, 11), np.int64), np.empty((0, 4))
        self._offsets: dict[int, Offsets] = {}
        self._oversize: dict[int, float] = {}
        self._placed_iou: dict[int, float] = {}

    def __len__(self) -> int:
        return len(self._ints) + len(self._rows)

    def own_miss(
        self,
        reason: MissReason,
        number: int,
        stamp_ns: int,
        now_ns: int,
    ) -> None:
        self._rows.append(
            (OWN_MISS, REASONS.index(reason), now_ns, 0, stamp_ns, number, stamp_ns, 0, 0, 0, 0)
        )
        self._values.append((0.0, 0.0, 0.0, 0.0))

    def pair(self, pair: PairVerdict, now_ns: int) -> None:
        candidate = pair.candidate
        verdict = pair.verdict
        at = pair.own
        if candidate is None:
            return
        head = (now_ns, candidate.sequence, pair.capture_ns)
        if pair.own_box is None or pair.mapped_box is None or at is None or candidate.box is None:
            self._rows.append((MISS, REASONS.index(verdict.reason), *head, 0, 0, 0, 0, 0, 0))  # type: ignore[union-attr]
            self._values.append((0.0, 0.0, 0.0, 0.0))
            return
        theirs = self.whose[candidate.sequence]
        right = int(theirs == TARGET)
        same = int(theirs == self.own_whose[at.before.frame])
        own = (at.before.frame, at.before.stamp_ns, at.after.frame, at.after.stamp_ns)
        self._rows.append((PAIR, -1, *head, *own, right, same))
        scores = (
            iou(pair.own_box, pair.mapped_box),
            self._by_other(candidate, at.values, candidate.box, pair.own_box),
        )
        center, corner = scores if self._other == "corner" else scores[::-1]
        self._values.append((center, corner, at.values[7], candidate.sigma_m))
        if pair.offsets is not None:
            self._offsets[len(self) - 1] = pair.offsets
        self._oversize[len(self) - 1] = pair.oversize
        if isinstance(verdict, Agreed):
            self.agreed = len(self) - 1
        if pair.placed_iou is not None:
            self._placed_iou[len(self) - 1] = pair.placed_iou

    def _by_other(
        self,
        candidate: Candidate,
        values: tuple[float, ...],
        box: Box,
        own_box: Box,
    ) -> float:
        """The overlap by the mapping that the method does not use."""
        T_v_c2 = rigid_from_quat(normalized(candidate.rotation_v_c2), candidate.position_v_m)
        depths = values[7], depth_in(T_v_c2, (values[4], values[5], values[6]))
        mapped = map_box(self._views, T_v_c2, box, depths, self._other)
        return math.nan if mapped is None else iou(own_box, mapped)

    @property
    def series(self) -> Series:
        """All entries so far."""
        if self._rows:
            self._ints = np.concatenate((self._ints, np.array(self._rows, np.int64)))
            self._floats = np.concatenate((self._floats, np.array(self._values, float)))
            self._rows = []
            self._values = []
        ints = self._ints
        floats = self._floats
        return Series(
            kind=ints[:, 0], reason=ints[:, 1], now_ns=ints[:, 2], sequence=ints[:, 3], capture_ns=ints[:, 4],
            own=ints[:, 5:9], iou=floats[:, :2], z_m=floats[:, 2], pose_sigma_m=floats[:, 3], right=ints[:, 9] != 0,
            same=ints[:, 10] != 0, offsets=self._offsets, oversize=self._oversize, placed_iou=self._placed_iou,
        )  # fmt: skip


def _vector(row: Array) -> Vec3:
    x, y, z = row.tolist()
    return x, y, z
