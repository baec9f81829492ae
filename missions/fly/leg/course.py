"""The flight of a role's course: what runs beside it, what may end it, and the way down whatever
happens.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

from flight.harness.flights import RoleResult
from flight.outcome import MissionEnd, Outcome
from flight.phases import Phase
from missions.fly.leg.beside import keep_up, log_cpu, log_lateness, log_state, watch_estimator
from missions.fly.leg.session import RoleSession, as_end, unless_exit
from missions.ground.journal import setup_record

Course = Callable[[], Awaitable[None]]
Recovery = Callable[[MissionEnd | None], Awaitable[bool]]
# a bug is named, whoever flew after it
_STAYS = frozenset({Outcome.PILOT_OVERRIDE, Outcome.CRASHED})


async def fly_course(
    session: RoleSession,
    course: Course,
    recover: Recovery,
    good: Outcome = Outcome.COMMITTED,
) -> RoleResult:
    """Run a mission to its end: the course, then the recovery that brings the vehicle down.

    What was spawned goes on until the vehicle is down: the pilot keeps flying, and the other drone
    keeps hearing from this one. ``good`` is how a course ends that comes to its own end.
    """
    end: MissionEnd | None = None
    landed = False
    try:
        end = await run_course(session, course)
        landed = await run_recovery(session, recover, end)
        end = session.end = overridden(session, end)
        await session.say_goodbye()
    finally:
        await close_session(session)
    return conclude(session, end, landed, good)


def overridden(session: RoleSession, end: MissionEnd | None) -> MissionEnd | None:
    """Return the end of a course; that of a pilot, whose vehicle was taken on its way home."""
    override = session.pilot.override
    if not override or (end is not None and end.outcome in _STAYS):
        return end
    before = "" if end is None else f"; the mission had ended: {end}"
    return MissionEnd(Outcome.PILOT_OVERRIDE, f"{override}{before}")


async def run_course(session: RoleSession, course: Course) -> MissionEnd | None:
    """The course, and what runs beside every course; None when it came to its own end.

    Whatever ends the course first (its own end, a MissionEnd in anything that was spawned, a part's
    error, a stop) decides the outcome.
    """
    session.log.write(
        "/setup",
        session.now_ns(),
        setup_record(session.rig, session.role, session.config),
    )
    for beside in (
        session.pump(),
        session.report(),
        log_state(session),
        watch_estimator(session),
        log_cpu(session),
        log_lateness(session),
        keep_up(session),
        session.stopped(),
        session.guarding.keep(),
    ):
        session.spawn(beside)
    flown = asyncio.ensure_future(unless_exit(course()))
    try:
        await asyncio.wait([flown, session.ended], return_when=asyncio.FIRST_COMPLETED)
        if flown.done():
            error = flown.exception()
            end = as_end(error) if error else None
        else:
            end = session.ended.result()
    finally:
        await _cancel(flown)  # of a program that is itself cancelled nothing goes on
    guard = session.guarding.guard
    if end is not None and guard is not None:
        end = guard.behind(end)
    session.end = end
    session.ended_s = asyncio.get_running_loop().time()
    if end is not None:
        session.say(str(end))
    return end


async def run_recovery(
    session: RoleSession,
    recover: Recovery,
    end: MissionEnd | None,
) -> bool:
    """Brings the vehicle down, and returns whether the script landed it."""
    try:
        return await unless_exit(recover(end))
    except Exception as error:
        as_end(error)  # prints what nobody foresaw
        session.say(f"not landed by the script: {error}")
        return False


async def close_session(session: RoleSession) -> None:
    """Ends all that a session runs."""
    await session.cancel_spawned()
    guarding = session.guarding
    if guarding.guard is not None:
        guarding.guard.beat(guarding.beat())  # the last word on whose the vehicle is


def conclude(
    session: RoleSession,
    end: MissionEnd | None,
    landed: bool,
    good: Outcome = Outcome.COMMITTED,
) -> RoleResult:
    """The program's last records."""
    end = overridden(session, end)
    outcome, detail = (end.outcome, end.detail) if end else (good, "")
    session.log.write(
        "/outcome",
        session.now_ns(),
        {
            "outcome": outcome.label,
            "detail": detail,
            "responsible": session.responsible,
            "landed": landed,
        },
    )
    session.enter(Phase.DONE, outcome.label)
    return RoleResult(
        session.role,
        outcome,
        detail,
        session.responsible,
        landed,
        ended_s=session.ended_s,
    )


async def _cancel(task: asyncio.Future[None]) -> None:
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
