"""Beside every course: the vehicle's state and the processor's time are logged, and a busy computer
gives things up.
"""

from __future__ import annotations

import asyncio
import math

from drivers.interfaces import VehicleState
from drivers.lateness import watch_lateness
from flight.guard.battery import TELL_S, UNTOLD_S, untold_s
from flight.shedding import BEAT_S
from missions.fly.leg.session import RoleSession

_STATE_PERIOD_S = 0.1
_LOOK_PERIOD_S = 0.02  # as often as telemetry comes
_CPU_PERIOD_S = 1.0


async def log_state(session: RoleSession) -> None:
    """Log where the vehicle believes to be, for ever."""
    logged_ns = 0  # what no position was known at
    taken_back = 0
    battery = BatteryNews(session)
    told: set[str] = set()  # kinds of what the crew was told not to be believed
    while True:
        if session.pilot.taken_back > taken_back:
            taken_back = session.pilot.taken_back
            session.say(
                "ALARM: one message said that a pilot has the vehicle, the next took it back: who sends them?"
            )
        for what in [each for each in session.vehicle.ignored if each not in told]:
            told.add(what)
            session.say(f"ALARM: ignored {what}")
        state = session.vehicle.state
        battery.look(state)
        if state.stamp_ns > logged_ns:
            logged_ns = state.stamp_ns
            record = {
                "position_n_m": state.position_n_m,
                "velocity_n_mps": state.velocity_n_mps,
                "q_n_b": state.q_n_b,
                "mode": state.mode.value,
                "armed": state.armed,
                "battery": state.battery if math.isfinite(state.battery) else None,
                "radio": state.radio,
            }
            if state.gps is not None:
                record["gps_fix"], record["satellites"] = state.gps
            session.log.write("/state", logged_ns, record)
        await asyncio.sleep(_STATE_PERIOD_S)


async def watch_estimator(session: RoleSession) -> None:
    """Look at every state that the vehicle tells, for ever: what its estimator stepped by shows in
    one of them.
    """
    while True:
        session.note_steps()
        await asyncio.sleep(_LOOK_PERIOD_S)


class BatteryNews:
    """Tells the crew when a flying vehicle has stopped telling its battery's level, and when it
    tells it again.
    """

    def __init__(self, session: RoleSession) -> None:
        self._session = session
        self._kept = False

    def look(self, state: VehicleState) -> None:
        """Look at the newest state; each change is told once."""
        silent_s = untold_s(state.battery_ns, self._session.now_ns())
        kept = state.armed and silent_s > TELL_S
        if kept == self._kept:
            return
        self._kept = kept
        if not kept:
            self._session.say("the battery's level is told again")
            return
        level = (
            f"{100 * state.battery:.0f} %" if math.isfinite(state.battery) else "an unknown level"
        )
        self._session.say(
            f"ALARM: the battery's level is not told any more: {level} is believed for {UNTOLD_S:.0f} s, then this ends"
        )


async def log_cpu(session: RoleSession) -> None:
    """Log what processor time went to, for ever."""
    while session.stages is not None:
        session.log.write("/cpu", session.now_ns(), {"spent_ns": session.stages.spent_ns()})
        await asyncio.sleep(_CPU_PERIOD_S)


async def log_lateness(session: RoleSession) -> None:
    """Log when this program was late, and for how long it had no core, for ever. In virtual time
    nothing is late.
    """
    if session.stages is not None:
        await watch_lateness(lambda record: session.log.write("/late", session.now_ns(), record))


async def keep_up(session: RoleSession) -> None:
    """Give things up in order while the program is busy all the time, and take them up again, for
    ever.

    In virtual time nothing is late.
    """
    loop = asyncio.get_running_loop()
    while session.stages is not None:
        due_s = loop.time() + BEAT_S
        await asyncio.sleep(BEAT_S)
        changed = session.frames.shedding.beat(loop.time() - due_s)
        if changed is not None:
            record = {"what": changed.what, "gone": changed.gone, "busy": changed.busy}
            session.log.write("/shed", session.now_ns(), record)
            session.say(
                f"this computer is busy: {'gives up' if changed.gone else 'takes up again'} {changed.what}"
            )
