"""The beginnings of a relay's faults: each leg is a hand-over with faults of its own."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from itertools import chain

from drivers.interfaces import PartError
from flight.harness.flights import Progress
from hil.world.faults import Fault, FaultTrigger, parse_faults
from path.messages import Role


def faults_of_legs(
    asked: Mapping[int, Sequence[str]],
    level: str,
    *,
    in_process: bool,
) -> dict[int, list[Fault]]:
    """Read the faults of a relay or a team, by leg. Raises PartError for those that there are not.

    Args:
        in_process: all programs are in one process, in virtual time.
    """
    faults = {leg: parse_faults(texts, level) for leg, texts in asked.items()}
    for fault in chain(*faults.values()):
        if in_process and fault.kind.virtual:
            raise PartError(
                f"fault {fault.name} is one of a single hand-over",
                "fly it with handoff, on a rig of level sim",
            )
        attacks = fault.name == "attack"
        if attacks or (in_process and fault.kind.own):
            lacks = "programs of their own" if in_process else "a pair with a key"
            raise PartError(
                f"fault {fault.name} needs {lacks}", "fly it with handoff, on a rig of level sitl"
            )
    return faults


class LegFaults:
    """
    Args:
        faults: by the number of their leg; of 0 those of all legs.
        inject: called with the leg when a fault of it begins.
    """

    def __init__(
        self, faults: Mapping[int, Sequence[Fault]], inject: Callable[[int, Fault], None]
    ) -> None:
        self._faults = faults
        self._inject = inject
        self._ends: dict[int, dict[Role, str]] = {}
        self._newest: dict[str, tuple[int, Role, FaultTrigger]] = {}
        self._coming: set[asyncio.Task[None]] = set()

    def open_leg(
        self,
        number: int,
        sender: str,
        receiver: str,
    ) -> None:
        self._ends[number] = {Role.SENDER: sender, Role.RECEIVER: receiver}
        trigger = FaultTrigger([*self._faults.get(0, ()), *self._faults.get(number, ())])
        for role, name in self._ends[number].items():
            self._newest[name] = number, role, trigger
        self._begin(number, trigger.from_the_start())

    def end_of(self, leg: int, role: Role) -> str:
        """The drone that has, or had, this role in a leg."""
        return self._ends[leg][role]

    def on_progress(self, name: str, progress: Progress) -> None:
        """Take the progress of a drone in either role.

        Of a role that it does not have in its newest leg nothing begins.
        """
        if name in self._newest:
            number, role, trigger = self._newest[name]
            if role is progress.role:
                self._begin(number, trigger.on_progress(progress))

    def on_duty(self, name: str, duty: str) -> None:
        """Take the duty that a drone has written down."""
        if name in self._newest:
            number, role, trigger = self._newest[name]
            self._begin(number, trigger.on_duty(role, duty))

    def waits_for_duty(self, name: str) -> bool:
        """Return whether ``on_duty`` can still bring something about."""
        return name in self._newest and self._newest[name][2].waits_for_duty(self._newest[name][1])

    def close(self) -> None:
        """End the faults: nothing begins any more."""
        for task in self._coming:
            task.cancel()

    def _begin(self, leg: int, faults: list[Fault]) -> None:
        for fault in faults:
            if fault.after_s:
                task = asyncio.ensure_future(self._later(leg, fault))
                self._coming.add(task)
                task.add_done_callback(self._coming.discard)
            else:
                self._inject(leg, fault)

    async def _later(self, leg: int, fault: Fault) -> None:
        await asyncio.sleep(fault.after_s)
        self._inject(leg, fault)
