"""Real time: the world and N named drones' programs and guards, each a process; started and ended
here.

One harness for every mission, which it knows nothing of. ``RealTimeRun.run`` is a run from top to
bottom: the world is started, the mission is flown, the world lands everybody and says what it
found, and nothing is left behind. The mission begins programs by their drones' names (``fly``) and
opens legs (``legs.open_leg``); faults begin in their legs by themselves. What is flown is said by
``Orders``: a handoff's are in ``hil.harness.sitl``, those of a relay or a team in
``hil.harness.relay_sitl``. The world's side is ``hil.harness.realtime.world``.
"""

from __future__ import annotations

import asyncio
import resource
import time
from collections.abc import Callable, Coroutine, Mapping
from typing import Any

from drivers.stop_signals import leave_signals, stop_on_signals
from hil.harness.preparation import starting
from hil.harness.realtime.children import (
    HarnessFailure,
    WorldTooSlow,
    finish_world,
    read_world,
    until_ready,
)
from hil.harness.realtime.orders import no_news
from hil.harness.realtime.programs import PROGRAM_END_S, LivePrograms
from path.messages import Role
from path.values import frozen


@frozen
class Ending:
    """The world's findings, {} when it gave none; why the run failed, and whether because all was
    too slow.

    ``cpu_s``: of all its processes.
    """

    finished: Mapping[str, Any]
    failure: str
    slow: str
    wall_s: float
    cpu_s: float


class RealTimeRun(LivePrograms):
    """One run in real time, of any number of drones."""

    async def run(
        self,
        mission: Callable[[], Coroutine[Any, Any, None]],
        limit_s: float,
        landing_s: float,
    ) -> Ending:
        """From the start of the world to its findings. Whatever happens, no process outlives it.

        Args:
            limit_s: what the mission may take before everybody is told to land.
            landing_s: what the vehicles are given to be down after it.
        """
        start_s = time.monotonic()
        cpu_s = _children_s()
        failure = ""
        slow = ""
        finished = dict[str, Any]()
        try:
            await self._start_world()
            await self._fly_until(asyncio.ensure_future(mission()), limit_s)
            finished = await finish_world(self.world, landing_s)
        except WorldTooSlow as error:
            failure = slow = str(error)
        except HarnessFailure as error:
            failure = str(error)
        finally:
            await self.close()
        failure = failure or ("" if finished else "the world gave no findings")
        return Ending(finished, failure, slow, time.monotonic() - start_s, _children_s() - cpu_s)

    async def _start_world(self) -> None:
        def warming(what: str) -> None:
            for role in Role:
                self._orders.emit(starting(role, what))

        self.world = await self.spawn(self._orders.world, "world")
        self.said["ready"] = await until_ready(self.world, warming)

    async def _fly_until(self, mission: asyncio.Future[None], limit_s: float) -> None:
        """Until the mission is over. Raises HarnessFailure when the world fails, or it takes far
        too long.
        """
        stop_on_signals(self.interrupt)
        beside = [
            asyncio.ensure_future(each) for each in (self._watch_world(), self._watch_records())
        ]
        if self._orders.news is not no_news:
            beside.append(asyncio.ensure_future(self._tell_news()))
        try:
            done, _ = await asyncio.wait(
                [mission, *beside],
                timeout=limit_s,
                return_when=asyncio.FIRST_COMPLETED,
            )
            if not done:
                self.interrupt()
                await asyncio.wait([mission], timeout=PROGRAM_END_S)
                raise HarnessFailure(f"the run did not end within {limit_s:.0f} s")
            for task in done:
                task.result()
        finally:
            self.legs.close()
            for task in (mission, *beside):
                task.cancel()
            await asyncio.gather(mission, *beside, return_exceptions=True)
            leave_signals()

    async def _watch_world(self) -> None:
        while True:
            event = await read_world(self.world)
            if "event" in event:
                self.said[event["event"]] = event


def _children_s() -> float:
    """Return the processor time of the processes that have ended."""
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    return spent.ru_utime + spent.ru_stime
