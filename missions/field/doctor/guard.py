"""The short test of the guard's own way to the vehicle."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

from drivers.mavlink.guard.interfaces import Watched
from drivers.rig.part_check import Finding

WAIT_S = 5.0
POLL_S = 0.01


async def check_guard(watched: Watched) -> AsyncIterator[Finding]:
    """Open, wait for heartbeat and position, close. It is asked for its rates, and commanded
    nothing.

    Raises VehicleError when its port cannot be had.
    """
    async with watched:
        loop = asyncio.get_running_loop()
        start_s = loop.time()
        heartbeat_s: float | None = None
        while loop.time() - start_s < WAIT_S:
            view = watched.view()
            if view is not None:
                heartbeat_s = heartbeat_s or loop.time() - start_s
                if view.position_ns:
                    yield Finding(
                        "ok",
                        "hears",
                        f"{watched.name}: heartbeat after {heartbeat_s:.1f} s, position too",
                    )
                    return
            await asyncio.sleep(POLL_S)
        if heartbeat_s is None:
            fix = "let the autopilot or a MAVLink router send to this address too: it is a link of its own"
            yield Finding("fault", "hears", f"no heartbeat of {watched.name} in {WAIT_S:g} s", fix)
        else:
            fix = "the vehicle needs a position, and must send GLOBAL_POSITION_INT on this link"
            yield Finding(
                "fault",
                "hears",
                f"{watched.name}: heartbeat, but no position in {WAIT_S:g} s",
                fix,
            )
