"""The harness of a relay and of a team: one field of many drones and targets, their programs in one
process.

It runs in virtual time, and knows nothing of missions: in a relay all drones are around one target.
"""

from __future__ import annotations

import asyncio
import time
from typing import Any

from drivers.collector import collector_off
from drivers.stop_signals import stop_on_signals
from flight.harness.relay import RelayReport, RelayRequest
from hil.harness.drone import present_s, until
from hil.harness.leg_faults import faults_of_legs
from hil.harness.preparation import prepare, starting
from hil.harness.relay_field import VirtualField
from hil.harness.sim import mission_config
from hil.harness.virtual_time import run_virtual
from hil.world.check import refuse_slow
from hil.world.estimator import reported
from hil.world.faults import Fault
from path.messages import Role

NEAR_PERIOD_S = 0.04  # looks at the truth while two are in the air
PERIOD_S = 0.2
VEHICLES_S = 1.0
SAMPLE_S = 10.0
LANDING_LIMIT_S = 90.0


class RelaySim:
    """Flies a relay or a team of level ``sim``."""

    def fly(self, request: RelayRequest) -> RelayReport:
        refuse_slow(request.rig)
        faults = faults_of_legs(request.faults, request.rig.level, in_process=True)
        prepare(request.rig, lambda what: request.emit(starting(Role.SENDER, what)))
        start_s = time.perf_counter()
        cpu_s = time.process_time()
        # nothing here lives in cycles, and collecting takes a tenth of the time
        with collector_off():
            findings = run_virtual(_RelayFlight(request, faults).run())
        cpu_s = time.process_time() - cpu_s
        return RelayReport(**findings, wall_s=time.perf_counter() - start_s, cpu_s=cpu_s)


class _RelayFlight:
    """One relay or team, from the first moment until everybody is down."""

    def __init__(self, request: RelayRequest, faults: dict[int, list[Fault]]) -> None:
        self._request = request
        self._field = VirtualField(request, mission_config(request.rig), faults)

    async def run(self) -> dict[str, Any]:
        """The fields of the RelayReport, without the wall's."""
        field = self._field
        stop_on_signals(field.programs.interrupt)
        watching = asyncio.create_task(self._watch())
        try:
            await self._request.main(field, field.programs.stop, self._request.emit)
        finally:
            await until(lambda: all(field.landed(name) for name in field.world.on), LANDING_LIMIT_S)
            watching.cancel()
            field.close()
        return self._findings()

    async def _watch(self) -> None:
        world = self._field.world
        monitors = self._field.monitors
        vehicles_s = 0.0
        sample_s = 0.0
        while True:
            now_s = present_s()
            if now_s != world.time_s:
                world.advance(now_s)
            monitors.on_truth(now_s)
            monitors.on_watched(now_s)
            if now_s >= vehicles_s:
                vehicles_s = now_s + VEHICLES_S
                monitors.on_vehicles(now_s, monitors.vehicles())
            if now_s >= sample_s:
                sample_s = now_s + SAMPLE_S
                monitors.sample(now_s, world.batteries, world.airborne)
            await asyncio.sleep(NEAR_PERIOD_S if len(world.airborne) > 1 else PERIOD_S)

    def _findings(self) -> dict[str, Any]:
        field = self._field
        aloft = [name for name in field.world.names if not field.landed(name)]
        failed = [drone.log.failed for drone in field.drones.values() if drone.log.failed]
        return {
            **field.monitors.findings(),
            "simulated_s": present_s(),
            "interrupted": field.programs.interrupted,
            "failure": f"not landed at the end: {', '.join(aloft)}" if aloft else "",
            "log_failure": failed[0] if failed else "",
            "errors": reported(self._request.rig),
        }
