"""One vehicle of a rig on the bench: the embedded one, or a real autopilot's simulator, behind the
same cable.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, Self
from urllib.parse import urlsplit

from pymavlink.dialects.v20 import common as mavlink

from drivers.interfaces import PartError, Vehicle, VehicleError
from drivers.mavlink.bench import CommandAnswer, HeardOnCable, HeartbeatShown, Instant
from drivers.mavlink.geodesy import LocalTangent
from drivers.mavlink.modes import KINDS, SAFETY_ARMED
from drivers.rig.parts import PartSpec, Rig, create, part_context
from drivers.rig.tables import decode_table
from hil.vehicle.mavlink_vehicle import MavlinkVehicle, MavlinkVehicleConfig
from hil.vehicle.simulators.followed_world import SimulatedVehicle
from hil.vehicle.simulators.process import SimulatorBroken
from hil.vehicle.simulators.relay import AUTOPILOT, MavlinkRelay
from hil.world.config import WorldConfig
from hil.world.dynamics import ATTITUDE, POSITION, VELOCITY
from hil.world.world import World
from path.messages import Quat, Role, Vec3

STEP_S = 0.005
SAMPLE_S = 0.02
SYSID = 9  # of a simulator: beside those of a run on the same computer
# HEARTBEAT, SYS_STATUS, COMMAND_ACK, EXTENDED_SYS_STATE, STATUSTEXT
DECODED = frozenset({0, 1, 77, 245, 253})

Truth = tuple[Vec3, Vec3, Quat]


class EmbeddedFarSide:
    """Physics and the embedded autopilot, stepped in this process; ``speed`` times as fast as the
    clock on the wall.
    """

    def __init__(
        self,
        rig: Rig,
        config: WorldConfig,
        url: str,
        seed: int,
    ) -> None:
        self.kind = "px4"
        self.what = "embedded"
        self._world = World(config, seed)
        options = rig.sender.vehicle.options
        origin = rig.origin
        sysid = int(options["sysid"])
        self.relay = MavlinkRelay(self.kind, sysid, ("127.0.0.1", 0), _listener(url))
        tangent = LocalTangent.at(origin)
        self._drone = self._world.drone(Role.SENDER)
        remote = self.relay.sockets[0].getsockname()
        self._endpoint = MavlinkVehicle(MavlinkVehicleConfig(sysid, remote), self._drone, tangent)

    def start(self) -> None:
        loop = asyncio.get_running_loop()
        for each in self.relay.sockets:
            loop.add_reader(each, lambda: self.relay.receive(0.0))

    def pump(self, now_s: float) -> None:
        self._world.advance(max(now_s, self._world.time_s))
        self._endpoint.pump(self._world.time_s)

    def truth(self) -> Truth | None:
        drone = self._drone
        return drone.true_position_n_m, drone.true_velocity_n_mps, drone.true_q_n_b

    def sag_battery(self, fraction: float) -> None:
        self._drone.autopilot.set_battery(fraction)

    def close(self) -> None:
        loop = asyncio.get_running_loop()
        for each in self.relay.sockets:
            loop.remove_reader(each)
        self._endpoint.close()
        self.relay.close()


class SimulatorFarSide:
    """A real autopilot with its own simulation, in real time from its start on."""

    def __init__(
        self,
        rig: Rig,
        config: WorldConfig,
        folder: Path,
    ) -> None:
        simulator = config.sender_simulator
        assert simulator is not None
        self.kind = self.what = simulator.kind
        # At its own speed from the start: how long it takes to be ready is measured.
        self._vehicle = SimulatedVehicle(
            rig,
            Role.SENDER,
            replace(simulator, speedup=1.0),
            config,
            folder,
        )
        relay = self._vehicle.relay
        if relay is None:
            raise PartError(
                f"{rig.name}: a board has its cable to itself", "name a rig of level sitl"
            )
        self.relay: MavlinkRelay = relay

    def start(self) -> None:
        self._vehicle.listen()
        self._vehicle.start()

    def pump(self, _now_s: float) -> None:
        self._vehicle.pump(0.0)

    def truth(self) -> Truth | None:
        follower = self._vehicle.follower
        if not follower.ready:
            return None
        row = follower.row(time.monotonic())
        n, e, d = row[POSITION].tolist()
        vn, ve, vd = row[VELOCITY].tolist()
        w, x, y, z = row[ATTITUDE].tolist()
        return (n, e, d), (vn, ve, vd), (w, x, y, z)

    def sag_battery(self, fraction: float) -> None:
        self._vehicle.link.sag_battery(fraction)

    def close(self) -> None:
        self._vehicle.close()


class EmbeddedBench:
    """A ``drivers.mavlink.bench.VehicleBench`` of the sender's vehicle in a rig of level ``sitl``.

    MAVSDK listens on a port of its own, a simulator has a number of its own: a run with the same
    rig is not disturbed.
    """

    def __init__(
        self,
        rig: Rig,
        folder: Path,
        speed: float = 1.0,
        seed: int = 0,
    ) -> None:
        """``speed``: of the embedded vehicle's time; a simulator has its own. Raises PartError,
        PartError.
        """
        config = decode_table(rig.world, WorldConfig, rig.where("world"))
        spec = rig.sender.vehicle
        url = f"udpin://127.0.0.1:{_free_port()}"
        options: dict[str, Any] = {**spec.options, "url": url}
        simulated = config.sender_simulator is not None
        if simulated:
            options["sysid"] = SYSID
        vehicle = PartSpec(spec.factory, options, spec.where, spec.base)
        self._rig = replace(rig, sender=replace(rig.sender, vehicle=vehicle))
        self._far: EmbeddedFarSide | SimulatorFarSide
        if simulated:
            self._far = SimulatorFarSide(self._rig, config, folder)
            self._speed = 1.0
        else:
            self._far = EmbeddedFarSide(self._rig, config, url, seed)
            self._speed = speed
        self.kind = self._far.kind
        self.what = self._far.what
        self._modes = next(kind for kind in KINDS if kind.name == self.kind)
        self._mav: Any = mavlink.MAVLink(None)
        self._start_s = time.monotonic()
        self._ground_d_m: float | None = None
        self._watched: Vehicle | None = None
        self._task: asyncio.Task[None] | None = None
        self._failure: Exception | None = None
        self.heard = HeardOnCable()
        self.instants: list[Instant] = []

    async def __aenter__(self) -> Self:
        self._far.relay.tap = self._hear
        self._start_s = time.monotonic()
        self._far.start()
        self._task = asyncio.create_task(self._run())
        return self

    async def __aexit__(self, *_: object) -> None:
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)
        self._far.close()

    @property
    def now_s(self) -> float:
        return self._speed * (time.monotonic() - self._start_s)

    @property
    def cut(self) -> bool:
        return self._far.relay.silent

    @cut.setter
    def cut(self, cut: bool) -> None:
        self._far.relay.silent = cut

    def check(self) -> None:
        if self._failure is not None:
            raise PartError(
                f"the bench failed: {self._failure}", "see output.txt of the simulator"
            ) from self._failure

    def watch(self, vehicle: Vehicle | None) -> None:
        self._watched = vehicle

    def vehicle(self) -> Vehicle:
        return create(self._rig.sender.vehicle, part_context(self._rig, Role.SENDER))

    def order(self, command: int, *params: float) -> None:
        self._far.relay.order(command, *params)

    def sag_battery(self, fraction: float) -> None:
        self._far.sag_battery(fraction)

    # --- inside ---

    async def _run(self) -> None:
        """Step the far side, and write down the truth."""
        sampled_s = -SAMPLE_S
        step_s = STEP_S / self._speed
        try:
            while True:
                now_s = self.now_s
                self._far.pump(now_s)
                if now_s - sampled_s >= SAMPLE_S - 1e-6:
                    sampled_s = now_s
                    self._sample(now_s)
                await asyncio.sleep(step_s)
        except (SimulatorBroken, OSError) as error:
            self._failure = error

    def _sample(self, now_s: float) -> None:
        truth = self._far.truth()
        if truth is None:
            return
        position, velocity, attitude = truth
        if self._ground_d_m is None:
            self._ground_d_m = position[2]
        said = None
        if self._watched is not None:
            with contextlib.suppress(VehicleError):
                said = self._watched.state
        self.instants.append(
            Instant(now_s, self._ground_d_m - position[2], position, velocity, attitude, said)
        )

    def _hear(
        self,
        message_id: int,
        frame: bytes,
        arrival_s: float,
    ) -> None:
        time_s = self._speed * (arrival_s - self._start_s)
        self.heard.arrivals_s.setdefault(message_id, []).append(time_s)
        if message_id not in DECODED:
            return
        try:
            message = self._mav.decode(bytearray(frame))
        except mavlink.MAVError:
            return
        if message.get_srcComponent() == AUTOPILOT:
            self._take(message, time_s)

    def _take(self, message: Any, time_s: float) -> None:
        heard = self.heard
        match message.get_type():
            case "HEARTBEAT":
                mode = self._modes.mode(message.custom_mode)
                armed = bool(message.base_mode & SAFETY_ARMED)
                heard.shown.append(HeartbeatShown(time_s, mode, message.custom_mode, armed))
            case "SYS_STATUS":
                passed = (
                    message.onboard_control_sensors_health & mavlink.MAV_SYS_STATUS_PREARM_CHECK
                )
                heard.checks.append((time_s, bool(passed)))
            case "COMMAND_ACK":
                heard.answers.append(
                    CommandAnswer(time_s, message.command, message.result, message.target_system)
                )
            case "EXTENDED_SYS_STATE":
                heard.landed.append((time_s, message.landed_state))
            case "STATUSTEXT":
                heard.texts.append((time_s, message.severity, str(message.text)))
            case _:
                pass


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def _listener(url: str) -> tuple[str, int]:
    parts = urlsplit(url)
    return parts.hostname or "127.0.0.1", parts.port or 0
