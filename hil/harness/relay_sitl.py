"""A relay or a team in real time: drones that are called, relieved and swapped by those on the
ground.
"""

from __future__ import annotations

import asyncio
import time
from itertools import combinations

import msgspec

from drivers.rig.check import check_rig
from drivers.rig.parts import Rig
from drivers.rig.tables import RigError
from flight.harness.fleet import RelayConfig, pair_of
from flight.harness.flights import RoleResult
from flight.harness.relay import (
    DroneProgram,
    FieldSample,
    FlightTruth,
    Pointed,
    RelayReport,
    RelayRequest,
    TargetWatch,
)
from flight.outcome import Outcome
from hil.harness.field import pointed, pointing
from hil.harness.leg_faults import faults_of_legs
from hil.harness.realtime.children import run_name
from hil.harness.realtime.orders import Command, Orders
from hil.harness.realtime.relay_world import run_of
from hil.harness.realtime.run import Ending, RealTimeRun
from hil.harness.realtime.world import world_command
from hil.world.check import refuse_slow
from hil.world.estimator import reported
from hil.world.faults import Fault
from path.messages import Role

LANDING_LIMIT_S = 60.0
POINT_AGAIN_S = 1.0
BEYOND_S = 240.0  # besides its hours: the last leg, the way home, and landing


class RelaySitl:
    """Flies a relay or a team of level ``sitl``."""

    def fly(self, request: RelayRequest) -> RelayReport:
        """Raise PartError for a rig whose drones are not told apart, and for faults that there are
        not.
        """
        check_drones(request.rig, request.config)
        refuse_slow(request.rig)
        faults = faults_of_legs(request.faults, request.rig.level, in_process=False)
        return asyncio.run(_fly(request, faults))


def check_drones(rig: Rig, config: RelayConfig) -> None:
    """Raise RigError when two drones are the same on the wire."""
    table = "drones" if rig.team else "[relay] drones"
    for drone in config.drones:
        if (
            drone.vehicle is None
            or drone.link is None
            or (rig.sender.guard is not None and drone.guard is None)
        ):
            what = f"{drone.name} needs a vehicle, a link, and in a rig with guards a guard, of its own in real time"
            raise RigError([rig.where(f"{table}: {what}")])
    for one, other in combinations(config.drones, 2):
        check_rig(pair_of(rig, one, other))


async def _fly(request: RelayRequest, faults: dict[int, list[Fault]]) -> RelayReport:
    run = RealTimeRun(orders_of(request), [drone.name for drone in request.config.drones], faults)
    field = LiveField(request, run)
    limit_s = 3600.0 * request.hours + BEYOND_S

    async def mission() -> None:
        await request.main(field, run.stop, request.emit)

    return report_of(request, run, await run.run(mission, limit_s, LANDING_LIMIT_S))


def orders_of(request: RelayRequest) -> Orders:
    config = request.config
    processes = request.processes
    more = str(len(config.drones)), str(len(request.targets)), str(request.hours)

    def guard(name: str) -> Command | None:
        return None if request.rig.sender.guard is None else processes.guard_command(name)

    return Orders(
        world=world_command("hil.harness.realtime.relay_world", request.rig, request.seed, *more),
        program=processes.command,
        guard=guard,
        out=request.out,
        emit=request.emit,
        shares=lambda name: run_of(run_name(), name),
        news=processes.news,
        heard=processes.heard,
    )


class LiveField:
    """The field as those on the ground can act on it (``flight.harness.relay.RelayField``)."""

    def __init__(self, request: RelayRequest, run: RealTimeRun) -> None:
        self._request = request
        self._run = run
        self._pointed: dict[int, Pointed] = {}
        self._pointing = pointing(request.seed)

    async def begin(self, name: str, program: DroneProgram) -> RoleResult | None:
        """Its program is a process, and knows what to fly: ``program`` is for others."""
        del program
        run = self._run
        run.tell_world({"on": name})
        await run.start_guard(name)
        result = await run.fly(name)
        self._tell("died" if result is None else "over", name)
        run.tell_world({"camera_off": name})
        if result is None and not run.drones[name].killed:
            what = f"its program died. {run.died(name)}"
            return RoleResult(Role.RECEIVER, Outcome.CRASHED, what, responsible=False, landed=False)
        return result

    def open_leg(
        self,
        number: int,
        sender: str,
        receiver: str,
    ) -> None:
        self._run.tell_world({"open": number, "sender": sender, "receiver": receiver})
        self._run.legs.open_leg(number, sender, receiver)

    def close_leg(self, number: int) -> None:
        sender, receiver = (
            self._run.legs.end_of(number, role) for role in (Role.SENDER, Role.RECEIVER)
        )
        self._run.tell_world({"close": number, "sender": sender, "receiver": receiver})

    def landed(self, name: str) -> bool:
        return bool(self._run.said.get("landed", {"landed": {}})["landed"].get(name, True))

    def battery(self, name: str) -> float:
        """As it was when it landed; of a drone that has not flown, the rig's."""
        own = next(drone for drone in self._request.config.drones if drone.name == name)
        return float(
            self._run.said.get("landed", {"batteries": {}})["batteries"].get(name, own.battery)
        )

    def swap(self, name: str, battery: float) -> None:
        self._run.end_guard(name)
        self._run.tell_world({"off": name, "battery": battery})

    # --- of a team ---

    def assign(self, name: str, target: int) -> None:
        self._run.tell_world({"assign": name, "target": target})

    def given_up(self, target: int) -> None:
        self._tell("given_up", target)

    def point_at(self, target: int) -> Pointed:
        """The place that the world last gave; whoever points is off by some centimetres."""
        before = self._pointed.get(target)
        if before is not None and time.monotonic() - before.time_s < POINT_AGAIN_S:
            return before
        said = self._pointed[target] = self._point_at(target)
        return said

    def _point_at(self, target: int) -> Pointed:
        said = self._run.said.get("targets")
        if said is None:  # it has not begun
            east, north = self._request.targets[target].place_m
            return Pointed((north, east, 0.0), (0.0, 0.0, 0.0), time.monotonic())
        *place_m, yaw_rad, speed_mps = said["where"][target]
        return pointed(place_m, yaw_rad, speed_mps, float(said["at_s"]), self._pointing)

    def _tell(self, what: str, about: str | int) -> None:
        self._run.tell_world({what: about, "at_ns": time.monotonic_ns()})


def report_of(
    request: RelayRequest,
    run: RealTimeRun,
    ending: Ending,
) -> RelayReport:
    finished = ending.finished
    wall_s = ending.wall_s
    unseen = [TargetWatch(None, 0.0, 0.0)] * max(1, len(request.targets))
    aloft = finished.get("aloft", ())
    closest_m = finished.get("closest_m", None)
    failed = [drone.result.log_failure for drone in run.drones.values() if drone.result is not None]
    return RelayReport(
        violations=finished.get("violations", {}),
        notes=(*finished.get("notes", ()), *run.missed),
        gaps_s={int(leg): gap_s for leg, gap_s in finished.get("gaps_s", {}).items()},
        flown=msgspec.convert(finished.get("flown", []), list[FlightTruth]),
        samples=msgspec.convert(finished.get("samples", []), list[FieldSample]),
        closest_m=float("nan") if closest_m is None else closest_m,
        closest_pair=tuple(finished.get("closest_pair", ())),
        simulated_s=finished.get("simulated_s", wall_s),
        wall_s=wall_s,
        cpu_s=ending.cpu_s,
        watched=msgspec.convert(finished["watched"], list[TargetWatch]) if finished else unseen,
        bytes_sent=finished.get("bytes_sent", {}),
        aloft_s=finished.get("aloft_s", {}),
        interrupted=run.interrupted,
        log_failure=next(filter(None, failed), ""),
        errors=reported(request.rig),
        overload=ending.slow or finished.get("overload", ""),
        explained=tuple(finished.get("explained", ())),
        failure=ending.failure or (f"not landed at the end: {', '.join(aloft)}" if aloft else ""),
    )
