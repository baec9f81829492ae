"""The opening of a role's parts, the session that is made of them, and the whole program of either
role of a leg.
"""

from __future__ import annotations

import gc
import random
from contextlib import AsyncExitStack
from typing import Any

import cv2

from drivers.interfaces import Clock, Link, Perception, Vehicle
from drivers.mavlink.guard.interfaces import GuardLine
from drivers.mavlink.guard.line import UdpGuardLine
from drivers.operator.interfaces import Operator
from drivers.resident import give_back
from drivers.rig.parts import PartContext, PartSpec, Rig, RoleRig, create, ended_by, part_context
from drivers.rig.tables import RigError
from drivers.stages import Stages
from flight.common_view import warm_up as warm_up_common_view
from flight.config import MissionConfig
from flight.guard.under_guard import UnderGuard
from flight.harness.flights import InProcess, ProgramContext, RoleResult
from missions.fly.leg.course import fly_course
from missions.fly.leg.receiver import Receiver
from missions.fly.leg.sender import Sender
from missions.fly.leg.session import RoleSession
from missions.ground.rig_library import mission_of
from path.marker.warm_up import warm_up
from path.messages import Role


async def open_session(
    stack: AsyncExitStack,
    rig: Rig,
    role: Role,
    config: MissionConfig,
    given: ProgramContext,
) -> RoleSession:
    """Make and open a role's parts, closed again by ``stack``; nothing is compiled any more after.
    Raises PartError.
    """
    harness = given.harness
    # frames are small: more threads cost more than they gain, and take the other processes' cores
    cv2.setNumThreads(1)
    warm_up_for(rig.role(role), harness)
    if rig.method.common_view:
        warm_up_common_view()
    if harness is None:
        # what is loaded by now stays: collections in flight need not walk it, for 0.1 s each
        gc.freeze()
    context = part_context(rig, role, harness)
    own = rig.role(role)
    link: Link = await _opened(stack, own.link, context)
    perception: Perception = await _opened(stack, own.perception, context)
    vehicle: Vehicle = await _opened(stack, own.vehicle, context)
    entropy = entropy_of(role.value, context.clock, harness)
    guard: UnderGuard | None = None
    if own.guard is not None:
        line = guard_line_of(own.guard, role, context.clock, harness)
        guard = UnderGuard(
            await stack.enter_async_context(line),
            context.clock,
            config.guard_process,
        )
    operator: Operator | None = None
    if own.operator is not None:
        operator = await _opened(stack, own.operator, context)
    leave_opening(harness)
    parts = (context.clock, vehicle, perception, link)
    stages = Stages() if harness is None else None
    session = RoleSession(
        rig,
        role,
        config,
        given.log,
        given.emit,
        given.stop,
        parts,
        entropy,
        guard,
        stages,
    )
    session.operator = operator
    return session


async def _opened(
    stack: AsyncExitStack,
    spec: PartSpec,
    context: PartContext,
) -> Any:
    """Make and open a part. Raises PartError, also for one whose opening ends the program."""
    try:
        return await stack.enter_async_context(create(spec, context))
    except SystemExit as error:
        raise RigError(
            [f"{spec.where}.factory: {spec.factory} cannot be opened: it {ended_by(error)}"]
        ) from error


def warm_up_for(own: RoleRig, harness: InProcess | None) -> None:
    """Compile what a drone will need, or load it: of images nothing where its perception has no
    camera.
    """
    warm_up(images=harness is None or "camera" in own.perception.options)


def leave_opening(harness: InProcess | None) -> None:
    """Give back what only the opening needed: most of it is the library that loads kernels, which
    is LLVM.

    In the world's own process others are still at it.
    """
    if harness is None:
        give_back()


def entropy_of(
    name: str,
    clock: Clock,
    harness: InProcess | None,
) -> random.Random:
    """Return a program's source of chance; in virtual time from the seed, and after a restart not
    the same again.
    """
    return (
        random.SystemRandom()
        if harness is None
        else random.Random(f"{name} {clock.now_ns()} {harness.seed}")
    )


def guard_line_of(
    guard: PartSpec,
    role: Role,
    clock: Clock,
    harness: InProcess | None,
) -> GuardLine:
    """A program's way to its role's guard."""
    return (
        UdpGuardLine(str(guard.options.get("bind", "")), clock)
        if harness is None
        else harness.guard_line(role)
    )


async def fly(
    rig: Rig,
    role: Role,
    given: ProgramContext,
) -> RoleResult:
    """Fly a role from the opening of its parts to the vehicle on the ground. Raises PartError."""
    async with AsyncExitStack() as stack:
        session = await open_session(stack, rig, role, mission_of(rig), given)
        flown = (
            Sender(session, given.store) if role is Role.SENDER else Receiver(session, given.store)
        )
        return await fly_course(session, flown.course, flown.recover)
