"""The parts of one role, each with its own short test. Nothing moves, nothing is armed, everything
is closed again.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator
from dataclasses import replace
from functools import partial

from drivers.interfaces import PartError
from drivers.rig.part_check import Finding
from drivers.rig.parts import PartSpec, Rig, create, part_context
from missions.field.doctor.beacons import check_beacons
from missions.field.doctor.guard import check_guard
from missions.field.doctor.link import check_link
from missions.field.doctor.perception import WantedMarker, check_detector, check_perception
from missions.field.doctor.vehicle import check_flyer, fence_of
from missions.ground.pace import detector_of
from missions.ground.rig_library import mission_of
from path.messages import Role
from path.values import frozen

WAIT_S = 4.0  # for the other end of the link
LIMIT_S = 40.0  # every driver has bounds of its own, far below; this is for what has none

Findings = Callable[[], AsyncIterator[Finding]]


@frozen
class PartTest:
    """One part's test. ``name``: role and part; ``doing``: what a person is told meanwhile."""

    name: str
    doing: str
    run: Findings


def part_tests(rig: Rig, role: Role) -> Iterator[PartTest]:
    """Yield the tests in the order in which a flight opens the parts. Raises RigError."""
    own = rig.role(role)
    context = part_context(rig, role)
    mission = mission_of(rig)
    min_battery = mission.guard.min_battery
    fence = fence_of(mission)
    wanted = WantedMarker.of(rig) if role is Role.RECEIVER else None

    async def detector(spec: PartSpec, rate_hz: float | None) -> AsyncIterator[Finding]:
        made = create(spec, context)
        yield Finding("ok", "loads", spec.factory.partition(":")[2])
        yield check_detector(made, context.camera, rate_hz, context.clock)

    def vehicle() -> AsyncIterator[Finding]:
        return check_flyer(
            create(own.vehicle, context),
            context.clock,
            min_battery,
            fence,
            rig.height,
        )

    def perception() -> AsyncIterator[Finding]:
        return check_perception(create(own.perception, context), context.clock, wanted)

    def link() -> AsyncIterator[Finding]:
        return check_link(create(own.link, context), context.clock, WAIT_S)

    def guard() -> AsyncIterator[Finding]:
        assert own.guard is not None
        return check_guard(create(own.guard, context))

    def beacons() -> AsyncIterator[Finding]:
        assert rig.reference is not None and rig.reference.beacons is not None
        wanted = {who: mounted.address for who, mounted in rig.reference.mounted.items()}
        return check_beacons(create(rig.reference.beacons, context), wanted, context.clock)

    found = detector_of(own.perception)
    if found is not None:
        yield PartTest(f"{role.value} detector", "its time for an image", partial(detector, *found))
    behind = [
        ("vehicle", "telemetry for 2 s", vehicle),
        ("perception", "frames for 2 s", perception),
        ("link", "pings for 2 s, up to 4 s of waiting for the other end", link),
    ]
    if own.guard is not None:
        behind.insert(1, ("guard", "a heartbeat on its own link", guard))
    if rig.reference is not None and rig.reference.beacons is not None:
        behind.append(("beacons", "positions for 3 s", beacons))
    for name, doing, run in behind:
        yield PartTest(
            f"{role.value} {name}",
            doing,
            run if rig.harness is None else partial(_stood_in, rig.harness),
        )


async def _stood_in(harness: str) -> AsyncIterator[Finding]:
    detail = (
        f"not tested: the harness {harness} stands in for it, only in a flight; it is no hardware"
    )
    yield Finding("note", "", detail, untested=True)


def run_test(test: PartTest, limit_s: float = LIMIT_S) -> list[Finding]:
    """All that was found, up to what ended the test. Ctrl-C closes the part before it goes on
    up.
    """
    found: list[Finding] = []

    async def collect() -> None:
        async with asyncio.timeout(limit_s):
            async for finding in test.run():
                found.append(finding)

    try:
        asyncio.run(collect())
    except PartError as error:
        found.append(Finding("fault", "", str(error), error.remedy))
    except TimeoutError:
        found.append(
            Finding(
                "fault",
                "",
                f"its test did not end within {limit_s:g} s",
                "see what holds it up",
            )
        )
    return [replace(finding, name=f"{test.name} {finding.name}".strip()) for finding in found]
