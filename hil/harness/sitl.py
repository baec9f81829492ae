"""A handoff in real time: the two drones of one leg, which are called by their roles, and how their
logs are judged.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from drivers.cpu_share import CpuShare
from drivers.interfaces import PartError
from drivers.log.mcap_log import LogRecord, parts, read_log
from drivers.rig.parts import Rig
from drivers.rig.tables import decode_table
from flight.harness.flights import FlightReport, FlightRequest
from hil.harness.inject import need_own_estimators, need_radios
from hil.harness.preparation import prepare
from hil.harness.realtime.orders import Command, Orders
from hil.harness.realtime.pace import frame_age_s, overload_of
from hil.harness.realtime.run import Ending, RealTimeRun
from hil.harness.realtime.world import world_command
from hil.harness.sim import LEG, mission_config
from hil.monitors.monitors import Monitors
from hil.monitors.setpoints import (
    LATE,
    Late,
    SetpointGap,
    all_explained,
    judged,
    late_of,
    told_with,
)
from hil.vehicle.simulators.process import binary_of
from hil.world.check import check_world
from hil.world.config import WorldConfig, drawn_imaging
from hil.world.estimator import reported
from hil.world.faults import Fault, parse_faults
from path.messages import Role

RUN_LIMIT_S = 360.0  # besides what the mission allows for verifying and following
LANDING_LIMIT_S = 45.0
ENDS = Role.SENDER.value, Role.RECEIVER.value


class SitlHarness:
    """Real MAVSDK, real sockets, rendered frames through pyrealsense2; vehicles embedded, or real
    autopilots.
    """

    check_rig = staticmethod(check_world)
    prepare = staticmethod(prepare)

    def fly(self, request: FlightRequest) -> FlightReport:
        """Raise PartError when the rig needs an autopilot that was not named, or a share of a core
        it cannot have.
        """
        config = decode_table(request.rig.world, WorldConfig, request.rig.where("[world]"))
        for role in Role:
            simulator = config.simulator(role)
            if simulator is not None and simulator.to_start:
                binary_of(simulator.kind)
            if (
                simulator is not None
                and simulator.on_board
                and "fc_link_loss" in " ".join(request.faults)
            ):
                raise PartError(
                    "fault fc_link_loss: the harness has no hold of the board's cable",
                    "pull it yourself",
                )
        faults = parse_faults(request.faults, request.rig.level)
        if any(fault.name == "attack" for fault in faults):
            _need_keys(request.rig)
        need_radios(request.rig, faults)
        need_own_estimators(request.rig, faults)
        with ExitStack() as stack:
            shares: dict[str, CpuShare] = {}
            if config.slow is not None:
                shares = {name: stack.enter_context(CpuShare(name, config.slow)) for name in ENDS}
            report = asyncio.run(_fly(request, faults, shares))
            share = {} if config.slow is None else {"share": config.slow}
            stopped = {
                f"{name}_stopped_s": round(each.stopped_s(), 3) for name, each in shares.items()
            }
            return replace(report, slow={**share, **stopped})


def _need_keys(rig: Rig) -> None:
    """Raise PartError when the drones would believe anybody."""
    for role in Role:
        if "key_file" not in rig.role(role).link.options:
            raise PartError(
                f"fault attack: {rig.where(f'{role.value}.link')} has no key_file, so that any packet is believed",
                "copy the rig, make a key (head -c 32 /dev/urandom > pair.key && chmod 600 pair.key), and name it "
                "there for both drones",
            )


async def _fly(
    request: FlightRequest, faults: list[Fault], shares: Mapping[str, CpuShare]
) -> FlightReport:
    run = RealTimeRun(orders_of(request, shares), ENDS, {LEG: faults})
    mission = mission_config(request.rig)

    limit_s = RUN_LIMIT_S + mission.deadlines.verify_s + mission.follow_after_s
    return report_of(request, run, await run.run(lambda: one_leg(run), limit_s, LANDING_LIMIT_S))


async def one_leg(run: RealTimeRun) -> None:
    """Both drones' programs to their end."""
    for name in ENDS:
        await run.start_guard(name)
    run.legs.open_leg(LEG, *ENDS)
    await asyncio.gather(*(run.fly(name) for name in ENDS))


def orders_of(request: FlightRequest, shares: Mapping[str, CpuShare]) -> Orders:
    rig = request.rig

    def begun(name: str, pid: int) -> None:
        if name in shares:
            shares[name].add(pid)

    def guard(name: str) -> Command | None:
        return (
            None
            if request.guard_command is None or not rig.role(Role(name)).guard
            else request.guard_command(Role(name))
        )

    def attack(rate: float, ready: object) -> Command:
        """The third process: it knows where both drones listen, and hears and sends on the air."""
        assert isinstance(ready, dict)
        ends = [str(rig.role(Role(name)).link.options["bind"]) for name in ENDS]
        return [
            *request.attack_command,
            f"{rate:g}",
            str(ready["air"]),
            *ends,
            str(request.seed),
            str(request.out),
        ]

    return Orders(
        world=world_command(
            "hil.harness.realtime.handoff_world", rig, request.seed, str(request.out)
        ),
        program=lambda name: request.role_command(Role(name)),
        guard=guard,
        out=request.out,
        emit=request.emit,
        attack=attack,
        begun=begun,
        awaited=frozenset(ENDS),
    )


def _records(out: Path) -> Iterator[tuple[int, Role, LogRecord | None]]:
    """Yield both roles' log records, of all their programs.

    None where the log of one ends without an outcome: it died.
    """
    for role in Role:
        for part in parts(out, role.value):
            newest_ns = 0
            ended = False
            for record in read_log(part):
                newest_ns = max(newest_ns, record.stamp_ns)
                ended = ended or record.topic == "/outcome"
                yield record.stamp_ns, role, record
            if not ended:
                yield newest_ns, role, None


def report_of(request: FlightRequest, run: RealTimeRun, ending: Ending) -> FlightReport:
    """The world's findings, and those of both programs' logs, judged in the order of time."""
    finished = ending.finished
    monitors = Monitors.of_pair(request.rig.method)
    ages_s: dict[str, list[float]] = {name: [] for name in ENDS}
    late: dict[str, list[Late]] = {name: [] for name in ENDS}
    start_ns = int(finished.get("start_ns", 0))
    for stamp_ns, role, record in sorted(_records(request.out), key=lambda entry: entry[0]):
        if record is None:
            monitors.on_death(role)
        else:
            monitors.on_record(role, record.topic, stamp_ns, record.record)
            ages_s[role.value] += frame_age_s(record.topic, record.record)
            if record.topic == LATE:
                late[role.value].append(late_of(record.record, (stamp_ns - start_ns) * 1e-9))
    violations = dict(monitors.violations)
    for name, count in finished.get("violations", {}).items():
        violations[name] = violations.get(name, 0) + count
    stalls = finished.get("stalls", ())
    gaps = [
        judged(gap, late[gap.who], stalls)
        for gap in (SetpointGap(**each) for each in finished.get("gaps", ()))
    ]
    dead = [name for name, drone in run.drones.items() if drone.result is None]
    return FlightReport(
        results={role: run.drones[role.value].result for role in Role},
        landed={role: bool(finished.get("landed", {}).get(role.value, False)) for role in Role},
        violations=violations,
        simulated_s=ending.wall_s,
        wall_s=ending.wall_s,
        interrupted=run.interrupted,
        failure=ending.failure,
        overload=ending.slow
        or overload_of(
            ages_s,
            finished.get("frames", {}),
            "the {}'s",
            finished.get("stood_s", 0.0),
            finished.get("stolen_s", 0.0),
            request.rig.world.get("slow"),
            gaps,
        ),
        explained=("S8",) if all_explained(violations, gaps) else (),
        notes=[
            *monitors.details,
            *run.missed,
            *told_with(finished.get("details", []), gaps),
            *(f"the {name}'s program died. {run.died(name)}" for name in dead),
        ],
        errors=reported(request.rig) | drawn_imaging(request.rig),
    )
