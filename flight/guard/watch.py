"""The guard of one vehicle: its rules behind one loop, with the vehicle and the role's program on
Protocols.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from dataclasses import replace

from drivers.interfaces import Clock, Log
from drivers.mavlink.guard.interfaces import BeatLine, GuardAnswer, GuardView, Script, Watched
from flight.config import MissionConfig
from flight.guard.rules import (
    Act,
    GuardStage,
    GuardState,
    Limits,
    ProgramBeat,
    decide,
    flown_by_scripts_alone,
    was_let_go,
)

TICK_S = 0.02
VIEW_PERIOD_S = 0.5  # of the vehicle in the log
STALL_S = 0.1  # between two ticks: the guard itself did not run


class GuardWatch:
    """Watches one vehicle. ``tick`` is called about every ``TICK_S``; nothing in it blocks."""

    def __init__(
        self,
        vehicle: Watched,
        line: BeatLine,
        clock: Clock,
        config: MissionConfig,
        log: Log,
        tell: Callable[[GuardState, Act], None] = lambda _state, _act: None,
        warn: Callable[[str], None] = lambda _what: None,
    ) -> None:
        """``tell`` is called with every decision, ``warn`` with each kind of thing that is ignored,
        once.
        """
        self._tell = tell
        self._warn = warn
        self._alarms: list[str] = []
        guard = config.guard
        self._vehicle = vehicle
        self._line = line
        self._clock = clock
        self._log = log
        self._rules = config.guard_process
        self._limits = Limits(guard.fence(), guard.min_battery, config.separation.minimum_m)
        self._state = GuardState()
        self._heard: ProgramBeat | None = None
        self._setpoints = 0
        self._ticked_ns: int | None = None
        self._logged_ns = 0
        self.peer: Watched | None = None  # the other vehicle, when this program watches both

    @property
    def state(self) -> GuardState:
        return self._state

    @property
    def needed(self) -> bool:
        """A script flies the vehicle or the guard brings it down, and it can be seen."""
        view = self._vehicle.view()
        heard = self._heard
        if view is None or not view.armed or not self.sees(self._clock.now_ns()):
            return False
        if flown_by_scripts_alone(view) and was_let_go(self._state, heard):
            return True  # who it was let go of for may not be there
        if self._state.stage is GuardStage.WATCHING:
            return heard is not None and heard.script.flies
        return self._state.stage in (GuardStage.HOLDING, GuardStage.LANDING)

    @property
    def flown(self) -> bool:
        """Return whether the vehicle is armed, by whomever, and can be seen."""
        view = self._vehicle.view()
        return view is not None and view.armed and self.sees(self._clock.now_ns())

    @property
    def hears(self) -> bool:
        """The role's program beats."""
        heard = self._heard
        return (
            heard is not None
            and (self._clock.now_ns() - heard.beat_ns) * 1e-9 <= self._rules.beat_age_s
        )

    def sees(self, now_ns: int) -> bool:
        """Return whether the own link brings telemetry."""
        return self._sees(self._vehicle.view(), now_ns)

    def _sees(self, view: GuardView | None, now_ns: int) -> bool:
        oldest_ns = 0 if view is None else min(view.heartbeat_ns, view.position_ns)
        return oldest_ns > 0 and (now_ns - oldest_ns) * 1e-9 <= self._rules.blind_s

    def tick(self) -> None:
        """Take what came in, decide, send, answer."""
        now_ns = self._clock.now_ns()
        self._forgive_own_stall(now_ns)
        news = self._listen()
        view = self._vehicle.view()
        self._look_at_ignored(now_ns)
        if view is not None and not view.armed:
            self._forget(now_ns)
        before = self._state
        self._state, act = decide(
            before,
            view,
            self._heard_now(),
            now_ns,
            self._rules,
            self._limits,
        )
        if act is Act.HOLD:
            self._vehicle.hold()
        elif act is Act.LAND:
            self._vehicle.land()
        decided = act is not Act.NOTHING or self._state.stage is not before.stage
        if decided:
            self._tell(self._state, act)
            self._log_decision(now_ns, act)
        if news or decided:  # a role that sleeps finds the decision waiting for it
            self._line.answer(self._answer(view, now_ns))
        if view is not None and (now_ns - self._logged_ns) * 1e-9 >= VIEW_PERIOD_S:
            self._logged_ns = now_ns
            self._log_view(view, now_ns)

    def _look_at_ignored(self, now_ns: int) -> None:
        """Raise an alarm of each kind of thing that came and was not believed."""
        for what in (*self._vehicle.ignored, *self._line.ignored):
            if what not in self._alarms:
                self._alarms.append(what)
                self._log.write("/guard_alarm", now_ns, {"ignored": what})
                self._warn(what)

    def _forgive_own_stall(self, now_ns: int) -> None:
        """Time in which this program did not run says nothing about another one that may have had
        no core either.
        """
        ticked_ns = self._ticked_ns
        self._ticked_ns = now_ns
        if ticked_ns is None or self._heard is None or (now_ns - ticked_ns) * 1e-9 < STALL_S:
            return
        heard = self._heard
        stalled_ns = now_ns - ticked_ns
        self._heard = replace(
            heard,
            beat_ns=min(now_ns, heard.beat_ns + stalled_ns),
            setpoint_ns=min(now_ns, heard.setpoint_ns + stalled_ns),
        )
        self._log.write("/guard_stalled", now_ns, {"stalled_s": stalled_ns * 1e-9})

    def _listen(self) -> bool:
        """Take the newest beat; whether there was one."""
        newest = self._line.newest()
        if newest is None:
            return False
        arrival_ns, beat = newest
        before = self._heard
        moved = (
            before is None
            or beat.setpoints != self._setpoints
            or before.script is not Script.CONTROL
        )
        measured = not math.isnan(beat.separation_m)
        self._heard = ProgramBeat(
            beat_ns=arrival_ns,
            script=beat.script,
            setpoint_ns=arrival_ns if moved or before is None else before.setpoint_ns,
            separation_m=beat.separation_m if measured or before is None else before.separation_m,
            separation_ns=arrival_ns if measured or before is None else before.separation_ns,
            peer_n_m=beat.peer_n_m,
        )
        self._setpoints = beat.setpoints
        return True

    def _heard_now(self) -> ProgramBeat | None:
        heard = self._heard
        peer = self.peer.view() if self.peer else None
        return (
            replace(heard, peer_n_m=peer.position_n_m) if heard and peer and peer.in_air else heard
        )

    def _forget(self, now_ns: int) -> None:
        """A program that fell silent on the ground has no part in whatever flies next."""
        heard = self._heard
        if heard is not None and (now_ns - heard.beat_ns) * 1e-9 > self._rules.beat_age_s:
            self._heard = None

    def _answer(self, view: GuardView | None, now_ns: int) -> GuardAnswer:
        script = Script.IDLE if self._heard is None else self._heard.script
        armed = view is not None and view.armed
        alarm = self._alarms[-1] if self._alarms else ""
        return GuardAnswer(
            self._sees(view, now_ns),
            self._state.hand(script, armed),
            self._state.reason,
            alarm,
        )

    def _log_decision(self, now_ns: int, act: Act) -> None:
        state = self._state
        heard = self._heard
        view = self._vehicle.view()
        record = {
            "stage": state.stage.value,
            "act": act.value,
            "reason": state.reason,
            "beat_age_s": None if heard is None else (now_ns - heard.beat_ns) * 1e-9,
            "mode": None if view is None else view.mode.value,
        }
        self._log.write("/guard", now_ns, record)

    def _log_view(self, view: GuardView, now_ns: int) -> None:
        record = {
            "armed": view.armed,
            "in_air": view.in_air,
            "mode": view.mode.value,
            "position_n_m": view.position_n_m,
            "battery": view.battery,
            "script": None if self._heard is None else self._heard.script.name.lower(),
            "ignored": {**self._vehicle.ignored, **self._line.ignored},
        }
        self._log.write("/guard_view", now_ns, record)


async def watch(
    guards: tuple[GuardWatch, ...],
    until: asyncio.Event,
    tick_s: float = TICK_S,
) -> None:
    """Tick until told to end and nothing is flown by a script or held by a guard any more."""
    loop = asyncio.get_running_loop()
    due_s = loop.time()
    while not until.is_set() or any(guard.needed for guard in guards):
        for guard in guards:
            guard.tick()
        due_s = max(due_s + tick_s, loop.time())
        await asyncio.sleep(due_s - loop.time())
