"""Keyframes in flight: D1 sends them, and D2 finds where it is by them (docs/common-view.md).

Both wait for nobody: a frame is offered with each cycle and taken when it is time for one, and what
comes of it is worked out in a thread of its own while the cycles go on. In virtual time that takes
``SOLVE_S``, on every computer.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from typing import NamedTuple, TypeVar, TypeVarTuple

import numpy as np

from drivers.interfaces import Frame, Framed, View
from flight.common_view import (
    FLOWN,
    KEYFRAME_S,
    KeyframeReader,
    MeasuredPose,
    flown_on,
    keyframe_source,
    marker_pose,
    parts_hz,
    prior_by,
    prior_of,
)
from flight.frame.records import common_view_record
from flight.guidance import Vec3
from flight.outcome import MissionEnd, Outcome
from flight.rendezvous.marker_view import MarkerView
from missions.fly.leg.session import RoleSession
from path.arrays import Array
from path.common_view.estimate import CommonView, Unknown, common_view
from path.common_view.keyframe import Keyframe
from path.common_view.parts import Gathered, parts_of
from path.common_view.read import OWN, SENT
from path.common_view.search import Prior
from path.geometry.transforms import Matrix, Pose
from path.messages import KeyframePart
from path.observations import Missed

SOLVE_S = 0.1
"""In virtual time, of D2; D1's part takes half of it."""
LOOK_EVERY_NS = 400_000_000
"""D2 compares a frame with D1's newest keyframe so often, at the most."""
STALE_S = 2.5 * KEYFRAME_S
"""A keyframe that is older is not used any more."""
REPORTS = 128
"""Of D1's places that are kept: of more than ``STALE_S``."""

Result = TypeVar("Result")
Given = TypeVarTuple("Given")


async def aside(
    session: RoleSession, takes_s: float, work: Callable[[*Given], Result], *given: *Given
) -> Result:
    """Work something out in a thread of its own; in virtual time, which stands still meanwhile, let
    ``takes_s`` pass.
    """
    if session.stages is not None:
        return await asyncio.to_thread(work, *given)
    await asyncio.sleep(takes_s)
    return work(*given)


def check_depth(session: RoleSession, view: View) -> None:
    """Raise MissionEnd(UNFIT) where the rig asks for common views and a camera gives no depth."""
    if not session.rig.method.common_view:
        return
    if not isinstance(view, Framed) or "depth" not in view.frame.sizes:
        raise MissionEnd(
            Outcome.UNFIT,
            f"method.common_view needs pictures with depth, and the {session.role.value}'s camera"
            " gives none (so it is at level sim, and with a Tello): leave it out",
        )


def frame_of(view: View) -> Frame:
    """Return the frame of a view that was found to have depth before take-off."""
    assert isinstance(view, Framed), "check_depth refuses it"
    return view.frame


class KeyframesOut:
    """D1's side: a keyframe every ``KEYFRAME_S`` while frames are offered."""

    def __init__(self, session: RoleSession) -> None:
        rig = session.rig
        self._session = session
        self._source = keyframe_source(rig.sender.camera, rig.method, session.config)
        self._reader = KeyframeReader(self._source, rig.sender.camera)
        self._offered: tuple[Frame, Matrix] | None = None
        self._wanted = asyncio.Event()

    def offer(self, view: View, R_n_c: Matrix) -> None:
        """Take a frame if the one before is on its way; only then is it looked at."""
        if self._offered is None:
            self._offered = frame_of(view), R_n_c
            self._wanted.set()

    async def run(self) -> None:
        """Send what is offered, for ever."""
        session = self._session
        while True:
            await self._wanted.wait()
            self._wanted.clear()
            assert self._offered is not None
            frame, R_n_c = self._offered
            began_s = asyncio.get_running_loop().time()
            keyframe = await aside(session, 0.5 * SOLVE_S, self._reader.read, frame, R_n_c, SENT)
            for part in parts_of(keyframe, self._source.camera, frame.stamp_ns):
                session.link.send(part)
                await asyncio.sleep(1.0 / parts_hz())
            left_s = KEYFRAME_S - (asyncio.get_running_loop().time() - began_s)
            await asyncio.sleep(max(0.0, left_s))
            self._offered = None


class _Look(NamedTuple):
    """A frame of D2 to be compared with D1's keyframe, and what was reported for its instant."""

    frame: Frame
    T_n_c: Pose
    R_n_v: Matrix


class CommonViews:
    """D2's side: where D1's marker is, by D1's newest keyframe and this drone's newest frame.

    D1 may have flown on since its keyframe: how far, is taken from the places that it reports.
    """

    def __init__(self, session: RoleSession, marker: MarkerView) -> None:
        rig = session.rig
        self._session = session
        self._marker = marker
        self._mount = rig.sender.mount
        self._T_c1_v = rig.sender.mount.T_v_c.inverse()
        source = keyframe_source(rig.sender.camera, rig.method, session.config)
        own = keyframe_source(rig.receiver.camera, rig.method, session.config)
        self._reader = KeyframeReader(own, rig.receiver.camera)
        self._gathered = Gathered(source)
        self._first: Keyframe | None = None
        self._first_ns = 0  # when D1 saw it, by this drone's clock
        self._peer: deque[tuple[int, Vec3, Vec3]] = deque(maxlen=REPORTS)
        self._look: _Look | None = None
        self._looked_ns = 0
        self._wanted = asyncio.Event()

    def note_peer(self, stamp_ns: int, position_n_m: Vec3, velocity_n_mps: Vec3) -> None:
        """Take where the sender reports to be; one that is known already is ignored."""
        if not self._peer or stamp_ns > self._peer[-1][0]:
            self._peer.append((stamp_ns, position_n_m, velocity_n_mps))

    def hear(self, part: KeyframePart) -> None:
        """Take in a part of D1's keyframe."""
        if not self._session.alignment.ready:
            return
        gathered = self._gathered
        if gathered.begins(part) and gathered.usable and not gathered.complete:
            self._use()  # no more of it will come
        if gathered.add(part) and gathered.complete:
            self._use()

    def _use(self) -> None:
        self._first = self._gathered.keyframe()
        self._first_ns = self._session.alignment.to_own_ns(self._gathered.capture_ns)

    def look(self, view: View, T_n_c: Pose) -> None:
        """Take a frame, when it is time for one; only then is it looked at."""
        R_n_v = self._marker.R_n_v
        age_s = (view.stamp_ns - self._first_ns) * 1e-9
        if self._first is None or R_n_v is None or not 0.0 <= age_s <= STALE_S:
            return
        if self._look is None and view.stamp_ns - self._looked_ns >= LOOK_EVERY_NS:
            self._looked_ns = view.stamp_ns
            self._look = _Look(frame_of(view), T_n_c, R_n_v)
            self._wanted.set()

    async def run(self) -> None:
        """Solve what was looked at, for ever."""
        while True:
            await self._wanted.wait()
            self._wanted.clear()
            first = self._first
            look = self._look
            assert first is not None
            assert look is not None
            flown_n_m = self._peer_at(look.frame.stamp_ns) - self._peer_at(self._first_ns)
            age_s = (look.frame.stamp_ns - self._first_ns) * 1e-9
            prior = self._prior(first, look, flown_n_m)
            found, seen = await aside(self._session, SOLVE_S, self._solve, first, look, prior)
            if seen is not None:
                seen = self._now(seen, first, look, flown_n_m, age_s)
            self._note(look, age_s, found, seen)
            self._look = None

    def _peer_at(self, stamp_ns: int) -> Array:
        """Return where the sender was at an instant, by its reports."""
        stamps = [each[0] for each in self._peer]
        places = np.array([each[1] for each in self._peer])
        newest_ns, _, velocity = self._peer[-1]
        beyond_s = max(0.0, (stamp_ns - newest_ns) * 1e-9)
        place = [np.interp(stamp_ns, stamps, places[:, axis]) for axis in range(3)]
        return np.array(place) + beyond_s * np.array(velocity)

    def _prior(self, first: Keyframe, look: _Look, flown_n_m: Array) -> Prior:
        """Return where this drone's camera is in D1's levelled frame, as far as it is known: by the
        filter, or before and after a long coast by both drones' reports.
        """
        relative = self._marker.predict(look.frame.stamp_ns, look.T_n_c.R, look.R_n_v)
        if relative is not None:
            marker_l1 = first.R_l_c @ self._T_c1_v.t + flown_n_m
            depth = first.grid.depth[first.grid.depth > 0.0]
            range_m = float(np.median(depth)) if depth.size else 0.0
            return prior_by(relative, marker_l1, look.T_n_c.R, look.R_n_v, range_m)
        R_n_b1 = first.R_l_c @ self._mount.T_b_c.R.T
        camera_m = self._peer_at(self._first_ns) + R_n_b1 @ self._mount.T_b_c.t
        return prior_of(look.T_n_c.t - camera_m, self._session.config)

    def _solve(
        self, first: Keyframe, look: _Look, prior: Prior
    ) -> tuple[CommonView | Unknown, MeasuredPose | None]:
        second = self._reader.read(look.frame, look.T_n_c.R, OWN, first.patch_m)
        found = common_view(first, second, prior, FLOWN)
        if isinstance(found, Unknown):
            return found, None
        return found, marker_pose(found, first, second, self._T_c1_v)

    def _now(
        self, seen: MeasuredPose, first: Keyframe, look: _Look, flown_n_m: Array, age_s: float
    ) -> MeasuredPose:
        """Return the marker as it is in D2's frame, and not as it was in D1's keyframe."""
        T_b_v = self._mount.T_b_v
        then = first.R_l_c @ self._T_c1_v.R
        flown = flown_n_m + (look.R_n_v - then) @ (T_b_v.R.T @ T_b_v.t)
        return flown_on(seen, then, look.R_n_v, flown, age_s)

    def _note(
        self, look: _Look, age_s: float, found: CommonView | Unknown, seen: MeasuredPose | None
    ) -> None:
        """Give a pose to the filter, and log what came of it."""
        stamp_ns = look.frame.stamp_ns
        refused: Missed | None = None
        if seen is not None:
            refused = self._marker.note_common_view(
                stamp_ns, seen.T_c_v, seen.covariance, look.T_n_c.R, look.R_n_v
            )
        session = self._session
        record = common_view_record(stamp_ns, age_s, found, seen, refused)
        session.log.write("/common_view", session.now_ns(), record)
