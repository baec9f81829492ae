"""The world of drones that real autopilots fly: the simulators say where they are, and nothing here moves them."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import cast
from urllib.parse import urlsplit

from drivers.interfaces import FlightMode, PartError
from drivers.mavsdk_geodesy import LocalTangent
from drivers.rig import Rig
from hil.autopilot import Autopilot
from hil.autopilot_process import (
    FIRST_PORT,
    FIRST_TRUTH_PORT,
    AutopilotProcess,
    Home,
    SimulatorBroken,
    SimulatorConfig,
)
from hil.autopilot_values import OffboardSession
from hil.mavlink_relay import MavlinkRelay
from hil.simulator_link import SimulatorLink
from hil.truth_follower import TruthFollower
from hil.world import ROLES, SimDrone, World, WorldConfig
from path.messages import Role

POLL_S = 0.02
SILENT_S = 2.0  # without truth for this long there is no world any more


class RemoteAutopilot:
    """Answers for a real autopilot what the harness asks of an embedded one (``hil.autopilot.Autopilot``)."""

    def __init__(self, relay: MavlinkRelay, link: SimulatorLink) -> None:
        self._relay = relay
        self._link = link

    @property
    def armed(self) -> bool:
        return self._relay.watch.armed

    @property
    def mode(self) -> FlightMode:
        return self._relay.watch.mode

    @property
    def offboard_sessions(self) -> list[OffboardSession]:
        return self._relay.watch.offboard_sessions

    @property
    def setpoint_gap_s(self) -> float:
        return self._relay.watch.setpoint_gap_s

    def request_mode(self, now_s: float, mode: FlightMode, by_pilot: bool = False) -> None:
        """Only a pilot's change can be asked for."""
        del now_s, mode
        assert by_pilot
        self._relay.pilot_takes_over()

    def set_battery(self, fraction: float) -> None:
        """Let the simulated battery sag."""
        self._link.sag_battery(fraction)


class SimulatedVehicle:
    """One drone's simulator with both of its connections. In a ``sitl`` world it stands where MavlinkVehicle does."""

    def __init__(self, rig: Rig, role: Role, config: SimulatorConfig, world: WorldConfig, folder: Path) -> None:
        """Raises PartError when a port is taken or the simulator was not named."""
        options = rig.role(role).vehicle.options
        self.sysid = int(options["sysid"])
        self.config = config
        origin, home = rig.origin, world.home(role)
        tangent = LocalTangent(origin.latitude_deg, origin.longitude_deg, origin.altitude_m)
        east, north = home.position_m
        place = Home(*tangent.to_global(north, east, 0.0), home.heading_deg)
        self.follower = TruthFollower(world.airframe.leg_m)
        self._process: AutopilotProcess | None = None
        if not config.url:
            parameters = {**_numbers(options.get("parameters", {})), **config.parameters}
            own = folder / f"{role.value}-{config.kind}"
            self._process = AutopilotProcess(config.kind, self.sysid, place, parameters, own, config.speedup)
        url = urlsplit(str(options["url"]))
        companion = url.hostname or "127.0.0.1", url.port or 0
        vehicle = _address(config.url, FIRST_PORT + self.sysid - 1)
        truth = _address(config.truth_url, FIRST_TRUTH_PORT + self.sysid - 1)
        self.relay = MavlinkRelay(config.kind, self.sysid, vehicle, companion)
        self.link = SimulatorLink(config.kind, self.sysid, truth, tangent, self.follower)
        self._at_speed = config.speedup == 1.0
        self.epoch_s = time.monotonic()  # of the world's clock

    @property
    def silent(self) -> bool:
        return self.relay.silent

    @silent.setter
    def silent(self, silent: bool) -> None:
        self.relay.silent = silent

    def start(self) -> None:
        if self._process is not None:
            self._process.start()

    def listen(self) -> None:
        """Take packets as they come, from now on."""
        loop = asyncio.get_running_loop()
        for each in self.relay.sockets:
            loop.add_reader(each, lambda: self.relay.receive(self.epoch_s))
        loop.add_reader(self.link, self.link.receive)

    def close(self) -> None:
        loop = asyncio.get_running_loop()
        for each in (*self.relay.sockets, self.link):
            loop.remove_reader(each)
        self.relay.close()
        self.link.close()
        if self._process is not None:
            self._process.stop()

    def pump(self, _now_s: float) -> None:
        """Raises SimulatorBroken when it has died or says nothing any more."""
        if self._process is not None:
            self._process.check()
        self.link.receive()  # what waits while this process was busy is no silence
        now_s = time.monotonic()
        self.link.ask(now_s)
        silent_s = now_s - self.follower.newest_s
        if math.isfinite(silent_s) and silent_s > SILENT_S:
            raise SimulatorBroken(f"{self.config.kind} of vehicle {self.sysid} told no truth for {silent_s:.1f} s")

    def waits_for(self) -> list[str]:
        """What it lacks until a mission may start."""
        self.pump(0.0)
        missing = self.link.missing
        if missing or self._at_speed:
            return missing
        self._at_speed = abs(self.link.parameters.get("SIM_SPEEDUP", 0.0) - 1.0) < 1e-3
        self.link.set_parameter("SIM_SPEEDUP", 1.0)
        return [] if self._at_speed else ["real time"]

    def not_ready(self, missing: list[str], after_s: float) -> SimulatorBroken:
        """What is said of one that does not become ready."""
        said = " | ".join(self.link.texts[-3:]) or (self._process.last_words() if self._process else "nothing")
        return SimulatorBroken(
            f"{self.config.kind} of vehicle {self.sysid} not ready after {after_s:.0f} s: waiting for "
            f"{', '.join(missing)}; it says: {said}"
        )


class FollowedWorld(World):
    """Truth of the drones comes from their simulators; traffic and the faults of what is seen are as in any world."""

    def __init__(self, config: WorldConfig, seed: int, vehicles: Mapping[Role, SimulatedVehicle]) -> None:
        super().__init__(config, seed)
        self._vehicles = {role: vehicles[role] for role in ROLES}
        self._drones = {
            role: SimDrone(role, cast("Autopilot", RemoteAutopilot(each.relay, each.link)), self._states[i])
            for i, (role, each) in enumerate((role, vehicles[role]) for role in ROLES)
        }

    def advance(self, to_s: float) -> None:
        """To where the simulators say the drones are at ``to_s``."""
        if to_s < self.time_s:
            raise ValueError(f"the world is at {self.time_s} s and cannot go back to {to_s} s")
        for i, vehicle in enumerate(self._vehicles.values()):
            self._states[i] = vehicle.follower.row(to_s + vehicle.epoch_s)
        self.time_s, self._snapshot = to_s, None
        if self.both_in_air:
            self.min_separation_m = min(self.min_separation_m, self.separation_m)

    def _late_s(self) -> float:
        return 0.0  # the rows are of ``time_s``


@dataclass(frozen=True, slots=True)
class Readiness:
    """How long each simulator took until it could fly."""

    seconds: Mapping[Role, float]


async def start_simulators(vehicles: Mapping[Role, SimulatedVehicle]) -> Readiness:
    """Start all of them and wait until each can be armed and knows where it is. Raises SimulatorBroken, NoBinary."""
    start_s = time.monotonic()
    for vehicle in vehicles.values():
        vehicle.listen()
        vehicle.start()
    seconds: dict[Role, float] = {}
    while len(seconds) < len(vehicles):
        await asyncio.sleep(POLL_S)
        now_s = time.monotonic() - start_s
        for role, vehicle in vehicles.items():
            missing = vehicle.waits_for()
            if not missing:
                seconds.setdefault(role, now_s)
            elif now_s > vehicle.config.ready_s:
                raise vehicle.not_ready(missing, now_s)
    return Readiness(seconds)


def _numbers(table: object) -> dict[str, float]:
    return {str(name): float(value) for name, value in table.items()} if isinstance(table, Mapping) else {}


def _address(url: str, port: int) -> tuple[str, int]:
    if not url:
        return "127.0.0.1", port
    parts = urlsplit(url)
    if parts.hostname is None or parts.port is None:
        raise PartError(f"{url} is no address of a simulator", "write it as udp://127.0.0.1:14540")
    return parts.hostname, parts.port
