"""The short test of the ultrasonic beacons that trials measure against: which are heard, how often
and how well.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator, Iterator, Mapping
from contextlib import AsyncExitStack

import numpy as np

from drivers.interfaces import BeaconError, BeaconFix, Beacons, Clock
from drivers.rig.part_check import Finding, examined
from path.values import frozen

FIRST_S = 3.0
SAMPLE_S = 3.0
POOR = 50.0  # of 100, as the system rates its positions
RARE_HZ = 2.0
OLD_S = 1.0


@frozen
class BeaconReadings:
    """Positions as they were read, and how old each was by this computer's clock, s."""

    fixes: tuple[BeaconFix, ...]
    ages_s: tuple[float, ...]
    seconds: float


async def check_beacons(
    beacons: Beacons,
    wanted: Mapping[str, int],
    clock: Clock,
) -> AsyncIterator[Finding]:
    """Open, listen, close.

    Args:
        wanted: addresses by who carries them.

    Raises:
        BeaconError: its ports are there, but no position comes.
    """
    async with AsyncExitStack() as stack:
        try:
            await stack.enter_async_context(beacons)
        except BeaconError as error:
            fix = f"on the computer that listens to them: {error.remedy}"
            yield Finding("note", "", f"cannot be opened here: {error}", fix, untested=True)
            return
        heard = await _heard(beacons, clock)
        for finding in judged(heard, wanted):
            yield finding
        for own in await examined(beacons):
            yield own


async def _heard(beacons: Beacons, clock: Clock) -> BeaconReadings:
    fixes: list[BeaconFix] = []
    ages: list[float] = []
    first = await beacons.read(FIRST_S)
    loop = asyncio.get_running_loop()
    start_s = loop.time()
    fix = first
    while fix is not None and loop.time() - start_s < SAMPLE_S:
        fixes.append(fix)
        ages.append(math.nan if fix.host_ns is None else (clock.now_ns() - fix.host_ns) * 1e-9)
        fix = await beacons.read(FIRST_S)
    return BeaconReadings(tuple(fixes), tuple(ages), max(loop.time() - start_s, 1e-3))


def judged(heard: BeaconReadings, wanted: Mapping[str, int]) -> Iterator[Finding]:
    """One finding for each beacon of the rig, one for those that it does not name, one for their
    age.
    """
    for who, address in wanted.items():
        yield _beacon(who, address, heard)
    if others := sorted({fix.address for fix in heard.fixes} - set(wanted.values())):
        listed = ", ".join(map(str, others))
        yield Finding(
            "note",
            "others",
            f"heard, but not in the rig: {listed}",
            "correct the addresses in [reference]",
        )
    ages = [age for age in heard.ages_s if math.isfinite(age)]
    if ages:
        median = float(np.median(ages))
        detail = f"positions are {1e3 * median:.0f} ms old when they come"
        old = median > OLD_S
        yield Finding(
            "note" if old else "ok",
            "age",
            detail,
            "a faster port; see latency_s" if old else "",
        )


def _beacon(
    who: str,
    address: int,
    heard: BeaconReadings,
) -> Finding:
    own = [fix for fix in heard.fixes if fix.address == address]
    if not own:
        fix = (
            "wake it in the Dashboard, bring it within reach of the stationary ones, "
            "or correct its address in the rig"
        )
        return Finding("fault", who, f"beacon {address} gives no position", fix)
    rate_hz = len(own) / heard.seconds
    rated = [fix.quality for fix in own if math.isfinite(fix.quality)]
    quality = f", quality {float(np.median(rated)):.0f} of 100" if rated else ""
    detail = f"beacon {address}: {rate_hz:.1f} positions a second{quality}"
    if rate_hz < RARE_HZ:
        return Finding(
            "note",
            who,
            detail,
            "a higher update rate or fewer beacons in the Dashboard",
        )
    if rated and float(np.median(rated)) < POOR:
        return Finding("note", who, detail, "a free line of sight to three stationary beacons")
    return Finding("ok", who, detail)
