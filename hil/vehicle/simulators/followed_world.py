"""The world of drones that real autopilots fly: the simulators say where they are, and nothing here
moves them.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Mapping
from pathlib import Path
from typing import cast
from urllib.parse import urlsplit

from drivers.interfaces import PartError
from drivers.mavlink.geodesy import LocalTangent
from drivers.rig.parts import Rig
from hil.autopilot.autopilot import Autopilot
from hil.autopilot.simulator import Kind, SimulatorConfig
from hil.vehicle.simulators.link import SimulatorLink
from hil.vehicle.simulators.process import (
    FIRST_PORT,
    FIRST_TRUTH_PORT,
    AutopilotProcess,
    Home,
    SimulatorBroken,
)
from hil.vehicle.simulators.radio import SET_UP, SimulatedRadio
from hil.vehicle.simulators.relay import MavlinkRelay
from hil.vehicle.simulators.remote_autopilot import RemoteAutopilot
from hil.vehicle.simulators.truth_follower import TruthFollower
from hil.world.config import WorldConfig
from hil.world.world import SimDrone, World, receiver_off
from path.messages import Role

POLL_S = 0.02
# Where a board's own simulation begins, as its parameters are called; PX4's has no heading.
ON_BOARD_HOME: dict[Kind, tuple[str, ...]] = {
    "px4": ("SIH_LOC_LAT0", "SIH_LOC_LON0", "SIH_LOC_H0"),
    "ardupilot": ("SIM_OPOS_LAT", "SIM_OPOS_LNG", "SIM_OPOS_ALT", "SIM_OPOS_HDG"),
}
PLACED_M = 1.0  # from where the rig says that it stands
SILENT_S = 2.0  # without truth for this long there is no world any more


class SimulatedVehicle:
    """One drone's simulator with both of its connections. In a ``sitl`` world it stands where
    MavlinkVehicle does.
    """

    def __init__(
        self,
        rig: Rig,
        role: Role,
        config: SimulatorConfig,
        world: WorldConfig,
        folder: Path,
        seed: int = 0,
    ) -> None:
        """Raise PartError when a port is taken or the simulator was not named.

        ``seed``: of what the receiver's position is wrong by, and of where the drone was put down.
        """
        options = rig.role(role).vehicle.options
        self.sysid = int(options["sysid"])
        self.config = config
        origin = rig.origin
        home = world.true_home(role, seed) if config.to_start else world.home(role)
        # All of the simulation is as much higher as its GPS says too much: what is true is reckoned
        # from there.
        altitude_m = origin.altitude_m + world.altitude.error_m(list(Role).index(role), 0.0)
        tangent = LocalTangent(origin.latitude_deg, origin.longitude_deg, altitude_m)
        east, north = home.position_m
        off_n_m = (
            receiver_off(world.position_offset, seed) if role is Role.RECEIVER else (0.0, 0.0, 0.0)
        )
        place = Home(
            *tangent.to_global(north + off_n_m[0], east + off_n_m[1], 0.0), home.heading_deg
        )
        self.follower = TruthFollower(world.airframe.leg_m, off_n_m)
        self._process: AutopilotProcess | None = None
        with_radio = options.get("rc", "required") != "none" and not config.on_board
        if config.to_start:
            set_up = SET_UP[config.kind] if with_radio else {}
            parameters = {**set_up, **_numbers(options.get("parameters", {})), **config.parameters}
            own = folder / f"{role.value}-{config.kind}"
            self._process = AutopilotProcess(
                config.kind, self.sysid, place, parameters, own, config.speedup
            )
        self.relay: MavlinkRelay | None = None
        truth: tuple[str, int] | str = config.truth_url
        if not config.on_board:
            url = urlsplit(str(options["url"]))
            companion = url.hostname or "127.0.0.1", url.port or 0
            vehicle = _address(config.url, FIRST_PORT + self.sysid - 1)
            self.relay = MavlinkRelay(config.kind, self.sysid, vehicle, companion)
            truth = _address(config.truth_url, FIRST_TRUTH_PORT + self.sysid - 1)
        self.link = SimulatorLink(
            config.kind, self.sysid, truth, tangent, self.follower, "vision" in options
        )
        self.radio = SimulatedRadio(config.kind, self.sysid, self.link) if with_radio else None
        self._home = place
        self._home_n_m = (north, east)
        self._at_speed = config.speedup == 1.0
        self.epoch_s = time.monotonic()

    @property
    def epoch_s(self) -> float:
        """Zero of the world's clock, on the monotonic one."""
        return self.link.epoch_s

    @epoch_s.setter
    def epoch_s(self, epoch_s: float) -> None:
        self.link.epoch_s = epoch_s

    @property
    def silent(self) -> bool:
        return self.relay is not None and self.relay.silent

    @silent.setter
    def silent(self, silent: bool) -> None:
        """Silences the cable, where the harness has it in its hands."""
        if self.relay is not None:
            self.relay.silent = silent

    def start(self) -> None:
        if self._process is not None:
            self._process.start()
        if self.radio is not None:
            self.radio.start()

    def listen(self) -> None:
        """Take packets as they come, from now on."""
        loop = asyncio.get_running_loop()
        relay = self.relay
        if relay is not None:
            for each in relay.sockets:
                loop.add_reader(each, lambda: relay.receive(self.epoch_s))
        loop.add_reader(self.link, self.link.receive)

    def close(self) -> None:
        loop = asyncio.get_running_loop()
        relay = self.relay
        loop.remove_reader(self.link)
        if relay is not None:
            for each in relay.sockets:
                loop.remove_reader(each)
            relay.close()
        if self.radio is not None:
            self.radio.close()
        self.link.close()
        if self._process is not None:
            self._process.stop()

    def pump(self, world_s: float) -> None:
        """Take what came in, and send what the pilot's radio says. ``world_s``: the world's
        clock.

        Raises SimulatorBroken when it has died or says nothing any more.
        """
        if self._process is not None:
            self._process.check()
        self.link.receive()  # what waits while this process was busy is no silence
        now_s = time.monotonic()
        self.link.ask(now_s)
        if self.radio is not None:
            self.radio.pump(world_s)
            if self.radio.transmitter.kill and self.relay is not None:
                self.relay.watch.on_kill_switch(world_s)
        silent_s = now_s - self.follower.newest_s
        if math.isfinite(silent_s) and silent_s > SILENT_S:
            raise SimulatorBroken(
                f"{self.config.kind} of vehicle {self.sysid} told no truth for {silent_s:.1f} s"
            )

    def waits_for(self) -> list[str]:
        """Return what it lacks until a mission may start."""
        self.pump(0.0)
        missing = self.link.missing
        if not missing and self.config.on_board:
            self._check_place()
        if missing or self._at_speed:
            return missing
        self._at_speed = abs(self.link.parameters.get("SIM_SPEEDUP", 0.0) - 1.0) < 1e-3
        self.link.set_parameter("SIM_SPEEDUP", 1.0)
        return [] if self._at_speed else ["real time"]

    def _check_place(self) -> None:
        """A board begins where its own parameters say. Raises SimulatorBroken when that is not the
        rig's home.
        """
        north, east = self.follower.row(time.monotonic())[:2].tolist()
        off_m = math.dist((north, east), self._home_n_m)
        if off_m <= PLACED_M:
            return
        home = self._home
        names = ON_BOARD_HOME[self.config.kind]
        values = (
            f"{home.latitude_deg:.7f}",
            f"{home.longitude_deg:.7f}",
            f"{home.altitude_m:g}",
            f"{home.heading_deg:g}",
        )
        wanted = ", ".join(f"{name} {value}" for name, value in zip(names, values, strict=False))
        raise SimulatorBroken(
            f"{self.config.kind} of vehicle {self.sysid} stands {off_m:.1f} m from its home in the rig: "
            f"set {wanted}, and restart the board"
        )

    def not_ready(self, missing: list[str], after_s: float) -> SimulatorBroken:
        """Return the error of a simulator that does not become ready."""
        said = " | ".join(self.link.texts[-3:]) or (
            self._process.last_words() if self._process else "nothing"
        )
        return SimulatorBroken(
            f"{self.config.kind} of vehicle {self.sysid} not ready after {after_s:.0f} s: waiting for "
            f"{', '.join(missing)}; it says: {said}"
        )


class FollowedWorld(World):
    """Truth of the drones comes from their simulators; traffic and the faults of what is seen are
    as in any world.
    """

    def __init__(
        self, config: WorldConfig, seed: int, vehicles: Mapping[Role, SimulatedVehicle]
    ) -> None:
        super().__init__(config, seed)
        self._vehicles = {role: vehicles[role] for role in Role}
        self._drones = {
            role: SimDrone(
                cast("Autopilot", RemoteAutopilot(each.relay, each.link, each.radio)),
                self._states[i],
            )
            for i, (role, each) in enumerate((role, vehicles[role]) for role in Role)
        }

    def advance(self, to_s: float) -> None:
        """Advances to where the simulators say the drones are at ``to_s``."""
        if to_s < self.time_s:
            raise ValueError(f"the world is at {self.time_s} s and cannot go back to {to_s} s")
        for i, vehicle in enumerate(self._vehicles.values()):
            self._states[i] = vehicle.follower.row(to_s + vehicle.epoch_s)
        self.time_s = to_s
        self._changed()

    def _late_s(self) -> float:
        return 0.0  # the rows are of ``time_s``


async def start_simulators(vehicles: Mapping[Role, SimulatedVehicle]) -> None:
    """Start all of them and wait until each can be armed and knows where it is. Raises
    SimulatorBroken, PartError.
    """
    start_s = time.monotonic()
    for vehicle in vehicles.values():
        vehicle.listen()
        vehicle.start()
    ready: set[Role] = set()
    while len(ready) < len(vehicles):
        await asyncio.sleep(POLL_S)
        now_s = time.monotonic() - start_s
        for role, vehicle in vehicles.items():
            missing = vehicle.waits_for()
            if not missing:
                ready.add(role)
            elif now_s > vehicle.config.ready_s:
                raise vehicle.not_ready(missing, now_s)


def _numbers(table: object) -> dict[str, float]:
    return (
        {str(name): float(value) for name, value in table.items()}
        if isinstance(table, Mapping)
        else {}
    )


def _address(url: str, port: int) -> tuple[str, int]:
    if not url:
        return "127.0.0.1", port
    parts = urlsplit(url)
    if parts.hostname is None or parts.port is None:
        raise PartError(f"{url} is no address of a simulator", "write it as udp://127.0.0.1:14540")
    return parts.hostname, parts.port
