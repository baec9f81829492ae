"""The harness of a relay and of a team: one field of many drones and targets, their programs in one
process.

It runs in virtual time, and knows nothing of missions: in a relay all drones are around one target.
"""

from __future__ import annotations

import time

from drivers.collector import collector_off
from flight.harness.relay import RelayReport, RelayRequest
from hil.harness.leg_faults import faults_of_legs
from hil.harness.preparation import prepare, starting
from hil.harness.relay_field import VirtualField
from hil.harness.virtual_time import run_virtual
from hil.world.check import refuse_slow
from path.messages import Role


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
            findings = run_virtual(VirtualField(request, faults).run())
        cpu_s = time.process_time() - cpu_s
        return RelayReport(**findings, wall_s=time.perf_counter() - start_s, cpu_s=cpu_s)
