"""The world of a handoff in real time: two drones that are on from the start, the link between
them, and its log.

    python -m hil.harness.realtime.handoff_world RIG_FILE SEED ERRORS RUN_FOLDER -- [FOLDER ...]

Its vehicles are embedded, Tellos, or real autopilots.
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from contextlib import AsyncExitStack
from dataclasses import asdict
from pathlib import Path
from typing import Any

from drivers.log.mcap_log import McapLog
from drivers.rig.parts import Rig, RoleRig
from drivers.rig.tables import decode_table
from hil.beacons.pty import open_beacons, open_hedges
from hil.camera.shared import RUN_VARIABLE
from hil.harness.inject import inject_in_world
from hil.harness.realtime.operator import person_on_the_wire
from hil.harness.realtime.parts import (
    CameraView,
    camera_config,
    embedded_vehicle,
    proxy_side,
    say,
    shared_camera,
)
from hil.harness.realtime.world import TRUTH_STEPS, RealTimeWorld, VehicleOnTheWire, main
from hil.harness.sim import LEG, VEHICLES_EVERY, mission_config
from hil.link.air import Air
from hil.link.faulty import UdpFaultProxy
from hil.monitors.monitors import Monitors
from hil.monitors.scripts import vehicles_of
from hil.monitors.truth_log import TruthLog
from hil.tello.emulator import TelloEmulator
from hil.tello.video import TelloVideo
from hil.tello.world import is_tello, tello_of
from hil.vehicle.simulators.followed_world import FollowedWorld, SimulatedVehicle, start_simulators
from hil.world.config import WorldConfig
from hil.world.distances import clearance, obstacles_m
from hil.world.errors import as_built
from hil.world.snapshot import Snapshot
from hil.world.world import World
from path.messages import Role


class SitlWorld(RealTimeWorld):
    """One handoff's world. Its drones are called by their roles."""

    def __init__(self, rig: Rig, seed: int, out: str) -> None:
        super().__init__(rig, [role.value for role in Role])
        self._out = Path(out)
        self._seed = seed
        self._config = decode_table(rig.world, WorldConfig, rig.where("[world]"))
        self._built = as_built(rig, seed)
        self._world = World(self._config, seed)
        self._monitors = Monitors.of_pair(rig.method, mission_config(rig))
        self._own: dict[str, RoleRig] = {role: self._built.rig.role(role) for role in Role}
        self._videos: dict[Role, TelloVideo] = {}
        self._person = person_on_the_wire(rig, self._built, self._config.person, seed)

    @property
    def fleet(self) -> World:
        return self._world

    async def open(self, stack: AsyncExitStack) -> Mapping[str, Any]:
        rig = self.rig
        log = stack.enter_context(McapLog(self._out / "world.mcap", "world"))
        proxy = self.proxies[LEG] = UdpFaultProxy(
            proxy_side(rig.sender), proxy_side(rig.receiver), self._seed
        )
        await proxy.__aenter__()
        if self._config.sender_simulator is None:
            for role in Role:
                self.drones[role.value].vehicle = self._vehicle(role)
            self.start_s = time.monotonic()
        else:
            await self._start_simulators()
        # until both programs are ready, however long a busy computer takes
        self._world.hold_traffic()
        self._truth = TruthLog(log, round(self.start_s * 1e9))
        self._truth.scene(
            self._built.rig,
            self._monitors.min_separation_m,
            dict.fromkeys(Role, 0),
            self._config.target,
            self._world.obstacles,
        )
        for role in Role:
            self._start_camera(role)
        stack.enter_context(open_beacons(rig, self._seed, self._out, self.now_s, self._look))
        stack.enter_context(open_hedges(rig, self._seed, self.now_s, self._look))
        if self._person is not None:
            stack.callback(self._person.close)
        air = await stack.enter_async_context(Air(proxy))
        return {"air": air.port}

    def _vehicle(self, role: Role) -> VehicleOnTheWire:
        rig = self.rig
        world = self._world
        if is_tello(rig.role(role).vehicle):
            emulator, self._videos[role] = tello_of(
                rig, role, world.drone(role), world.config, self._seed, self.when_s
            )
            return emulator
        return embedded_vehicle(rig, rig.role(role), world.drone(role), self.when_s)

    async def _start_simulators(self) -> None:
        """Real autopilots fly the drones: the world then follows what their simulators say is
        true.
        """
        simulated = dict[Role, SimulatedVehicle]()
        for role in Role:
            config = self._config.simulator(role)
            assert config is not None
            simulated[role] = SimulatedVehicle(
                self.rig, role, config, self._config, self._out, self._seed
            )
            self.drones[role.value].vehicle = simulated[role]
        say({"event": "warming", "what": "waiting until the autopilots' simulators can be armed"})
        await start_simulators(simulated)
        self._world = FollowedWorld(self._config, self._seed, simulated)
        self.start_s = time.monotonic()
        for vehicle in simulated.values():
            vehicle.epoch_s = self.start_s

    def _start_camera(self, role: Role) -> None:
        video = self._videos.get(role)
        writer = video or shared_camera(os.environ[RUN_VARIABLE], self.rig, role)
        rate_hz = video.rate_hz if video is not None else float(camera_config(self.rig, role).fps)
        picture = CameraView(self._built, role, self._seed, depth=video is None)
        self.start_camera(
            role.value, picture, writer, rate_hz, 0.0 if role is Role.SENDER else 0.37
        )

    def _look(self) -> Snapshot:
        with self.lock:
            self._world.advance(max(self.now_s(), self._world.time_s))
            return self._world.snapshot()

    def seen_by(self, name: str) -> Snapshot:
        del name  # both of a pair are in every picture that one of them takes
        return self._world.snapshot()

    def watch(self, steps: int, now_s: float) -> None:
        world = self._world
        self._truth.modes(world)
        if self._person is not None:
            self._person.pump(world.snapshot())
        for video in self._videos.values():
            video.pump(self.start_s + world.time_s)
        if steps % TRUTH_STEPS == 0:
            self._truth.truth(world)
            self._monitors.on_near(now_s, world.closest(self._monitors.min_separation_m))
            self._monitors.on_target(now_s, clearance(world))
            self._monitors.on_obstacles(now_s, obstacles_m(world))
        # the roles' phases are in their logs: no S7 here
        if steps % (TRUTH_STEPS * VEHICLES_EVERY) == 0:
            self._monitors.scripts.on_truth(now_s, vehicles_of(world, self._own))

    def landed(self) -> bool:
        return all(self._world.landed(role) for role in Role)

    def inject(self, order: Mapping[str, Any], at_s: float) -> None:
        self._truth.fault(order["fault"], int(order["at_ns"]))
        role = None if order["drone"] is None else Role(order["drone"])
        inject_in_world(order["fault"], role, self._world, order["value"] or None)

    def findings(self) -> dict[str, Any]:
        monitors = self._monitors
        truth = self._truth
        world = self._world
        for role in Role:
            vehicle = self.drones[role.value].vehicle
            cut_off_s = self.drones[role.value].cut_off_s
            by_sticks = isinstance(vehicle, TelloEmulator)
            sessions = (
                vehicle.sessions if by_sticks else world.drone(role).autopilot.offboard_sessions
            )
            truth.setpoint_gap(role, world)
            monitors.on_offboard(role, sessions, cut_off_s)
        for detail in monitors.details:
            truth.violation(world.time_s, detail.partition(" ")[0], detail)
        return {
            "landed": {role.value: world.landed(role) for role in Role},
            "violations": dict(monitors.violations),
            "details": monitors.details,
            "gaps": [asdict(gap) for gap in monitors.gaps],
            "stalls": self.stalls,
            "start_ns": round(self.start_s * 1e9),
        }


if __name__ == "__main__":
    main(SitlWorld)
