"""One vehicle through the whole suite: from power-on to the last flight, whatever fails on the
way.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from contextlib import AsyncExitStack
from dataclasses import dataclass, field

from drivers.interfaces import PartError, Vehicle, VehicleError
from drivers.mavlink.bench import VehicleBench
from missions.proofs.conformance.flights import FLIGHTS, SuiteFlight
from missions.proofs.conformance.stage import ARM, POLL_S, READY_S, FlightStage, Values

HEARTBEAT_S = 60.0
OPEN_S = 120.0
TEXT_S = 0.5  # until the text that explains a refusal
AGAIN_S = 20.0  # on the ground after a flight, until it is switched off and on
# of a flight whose vehicle did what nobody foresaw
FAILURES = (PartError, AssertionError, IndexError, ValueError)


@dataclass(slots=True)
class VehicleMeasures:
    """The figures measured on one vehicle.

    Attributes:
        what: the vehicle in words.
        values: by the names of ``rows``; what is missing was not measured.
        failed: flight by flight, why it did not come to its end.
        restarts: how often it was switched off and on because it would not arm again.
    """

    what: str = ""
    values: Values = field(default_factory=dict[str, float | str | None])
    failed: dict[str, str] = field(default_factory=dict[str, str])
    restarts: int = 0


class FlightSuite:
    """Flies the flights one after the other. One that fails ends in a landing, or else by switching
    off.
    """

    def __init__(self, bench: Callable[[], VehicleBench], say: Callable[[str], None]) -> None:
        self._bench = bench
        self._say = say
        self._stack = AsyncExitStack()
        self._stage: FlightStage | None = None
        self.measured = VehicleMeasures()

    async def run(self, flights: Sequence[SuiteFlight]) -> VehicleMeasures:
        """Raise PartError when the vehicle never becomes ready to fly."""
        measured = self.measured
        try:
            for number, flight in enumerate(flights, 1):
                stage = await self._ready()
                self._say(f"{number}/{len(flights)} {flight.what}")
                try:
                    await _within(stage, flight, measured)
                except FAILURES as error:
                    measured.failed[flight.name] = str(error) or type(error).__name__
                    self._say(f"  not to its end: {measured.failed[flight.name]}")
                try:
                    await stage.down()
                except PartError as error:
                    self._say(f"  switched off in the air: {error}")
                    await self._off()
        finally:
            await self._off()
        return measured

    async def _ready(self) -> FlightStage:
        """A vehicle that can be armed: the one that has landed, or the same switched off and on."""
        stage = self._stage
        if stage is not None:
            try:
                await stage.vehicle.wait_armable(AGAIN_S)
            except PartError as error:
                self._say(f"  switched off and on: {error}")
                self.measured.restarts += 1
                await self._off()
            else:
                return stage
        self._say("switched on, until it can be armed")
        bench = await self._stack.enter_async_context(self._bench())
        stage = self._stage = FlightStage(bench)
        self.measured.what = bench.what
        found = await _start(stage, self._stack)
        self.measured.values = {**found, **self.measured.values}  # of the first start
        return stage

    async def _off(self) -> None:
        stack = self._stack
        self._stack = AsyncExitStack()
        self._stage = None
        await stack.aclose()


async def _within(
    stage: FlightStage,
    flight: SuiteFlight,
    measured: VehicleMeasures,
) -> None:
    """The flight, within its limit. Raises PartError."""
    task = asyncio.ensure_future(flight.fly(stage))
    try:
        if await stage.until(task.done, flight.limit_s) is None:
            raise PartError(f"not over after {flight.limit_s:g} s")
        measured.values |= task.result()
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


async def _start(stage: FlightStage, stack: AsyncExitStack) -> Values:
    """Power-on until ready, with one attempt to arm at the first heartbeat."""
    heard = stage.heard
    if await stage.until(lambda: bool(heard.shown), HEARTBEAT_S) is None:
        raise PartError(f"no heartbeat within {HEARTBEAT_S:g} s")
    found: Values = {"heartbeat_s": heard.shown[0].time_s, **await _arm_early(stage)}
    stage.vehicle = await _opened(stage, stack)
    if await stage.until(lambda: stage.vehicle.state.armable, READY_S) is None:
        raise PartError(f"not ready within {READY_S:g} s: {stage.texts(0.0)}")
    found["ready_s"] = stage.now_s
    found["armable_s"] = next((time_s for time_s, passed in heard.checks if passed), None)
    return found


async def _arm_early(stage: FlightStage) -> Values:
    """Arms by the second ground station: the driver waits until it has an attitude."""
    sent_s = stage.now_s
    answer = await stage.order(ARM, 1.0)
    await stage.wait(TEXT_S)
    return {"early_arm": answer, "early_arm_text": stage.texts(sent_s)}


async def _opened(stage: FlightStage, stack: AsyncExitStack) -> Vehicle:
    """The driver, open: one that just began to boot may not answer, or not know how it stands."""
    while True:
        try:
            return await stack.enter_async_context(stage.bench.vehicle())
        except VehicleError:
            stage.bench.check()
            if stage.now_s > OPEN_S:
                raise
            await asyncio.sleep(POLL_S)


def chosen(words: Sequence[str]) -> list[SuiteFlight]:
    """The flights with one of these words in their name or title; all when there are none. Raises
    PartError.
    """
    own = [
        flight
        for flight in FLIGHTS
        if not words or any(word in f"{flight.name} {flight.what}" for word in words)
    ]
    if not own:
        names = ", ".join(flight.name for flight in FLIGHTS)
        raise PartError(
            f"no flight is called {' or '.join(words)}", f"--only takes one of: {names}"
        )
    return own
