"""The world of a ``sitl`` run, a process of its own: physics, vehicles on the wire, cameras, the link between.

    python -m hil.harness.sitl_world RIG_FILE RUN_FOLDER SEED ERRORS

Commands come as lines of JSON on stdin (``{"begin": true}`` once both programs are ready, from which on the target's
time runs; ``{"fault": NAME, "value": X}``, ``{"finish": SECONDS}``), events go out as
lines of JSON on stdout (``ready``, then ``finished`` with the findings). A closed stdin ends it.
"""

from __future__ import annotations

import asyncio
import gc
import os
import signal
import sys
import threading
import time
from contextlib import AsyncExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from drivers.interfaces import PartError
from drivers.log.json_lines import JsonLines
from drivers.log.mcap_log import McapLog
from drivers.rig.file import load_rig
from drivers.rig.parts import Rig, with_errors
from drivers.rig.tables import decode_table
from hil.beacons.pty import open_beacons, open_hedges
from hil.camera.shared import RUN_VARIABLE
from hil.harness.inject import inject_in_world, inject_on_link
from hil.harness.live_world import (
    CameraThread,
    CameraView,
    at_pace,
    camera_config,
    embedded_vehicle,
    proxy_side,
    running,
    say,
    shared_camera,
)
from hil.harness.preparation import prepare
from hil.harness.sim import VEHICLES_EVERY, down, mission_config
from hil.link.air import Air
from hil.link.faulty import UdpFaultProxy
from hil.monitors.monitors import Monitors
from hil.monitors.scripts import vehicles_of
from hil.monitors.truth_log import TruthLog
from hil.tello.emulator import TelloEmulator
from hil.tello.video import TelloVideo
from hil.tello.world import is_tello, tello_of
from hil.vehicle.followed_world import FollowedWorld, SimulatedVehicle, start_simulators
from hil.vehicle.mavlink_vehicle import MavlinkVehicle
from hil.vehicle.simulator_process import SimulatorBroken
from hil.world.clearance import clearance
from hil.world.errors import as_built
from hil.world.faults import FAULTS
from hil.world.snapshot import Snapshot
from hil.world.world import World, WorldConfig
from path.messages import Role

TRUTH_STEPS = 4


@dataclass(slots=True)
class LiveWorld:
    """The world in real time. ``lock`` guards it: the cameras' threads look at it while physics steps it."""

    world: World
    start_s: float
    lock: threading.Lock = field(default_factory=threading.Lock)
    frozen: set[Role] = field(default_factory=set[Role])
    cut_off: dict[Role, list[float]] = field(default_factory=lambda: {role: [] for role in Role})

    def now_s(self) -> float:
        return time.monotonic() - self.start_s

    def snapshot(self) -> Snapshot:
        with self.lock:
            self.world.advance(max(self.now_s(), self.world.time_s))
            return self.world.snapshot()


@dataclass(frozen=True, slots=True)
class _Scene:
    """A ``hil.harness.live_world.CameraScene``."""

    live: LiveWorld
    role: Role

    def now_s(self) -> float:
        return self.live.now_s()

    def look(self) -> tuple[int, Snapshot] | None:
        if self.role in self.live.frozen:
            return None
        snapshot = self.live.snapshot()
        return round((self.live.start_s + snapshot.time_s) * 1e9), snapshot


class SitlWorld:
    """One run's world: open it, run it, ask it for its findings."""

    def __init__(self, rig: Rig, out: Path, seed: int) -> None:
        config = decode_table(rig.world, WorldConfig, rig.where("[world]"))
        self._rig, self._out, self._seed, self._config = rig, out, seed, config
        self._built = as_built(rig, seed)
        self._live = LiveWorld(World(config, seed), 0.0)
        mission = mission_config(rig)
        self._monitors = Monitors(rig.method, mission.separation.minimum_m, mission.guard)
        self._finish_within_s: float | None = None
        self._commands = JsonLines(sys.stdin.fileno())
        self._vehicles: dict[Role, MavlinkVehicle | TelloEmulator | SimulatedVehicle] = {}
        self._videos: dict[Role, TelloVideo] = {}
        self._cameras: dict[Role, CameraThread] = {}

    async def run(self) -> None:
        rig, live = self._rig, self._live
        prepare(rig, lambda what: say({"event": "warming", "what": what}))
        gc.freeze()  # what is loaded by now stays: a full collection would stop the world for 0.1 s
        async with AsyncExitStack() as stack:
            log = stack.enter_context(McapLog(self._out / "world.mcap", "world"))
            self._proxy = await stack.enter_async_context(
                UdpFaultProxy(proxy_side(rig.sender), proxy_side(rig.receiver), self._seed)
            )
            if self._config.sender_simulator is None:
                for role in Role:
                    self._vehicles[role] = self._vehicle(role)
                    stack.callback(self._vehicles[role].close)
                live.start_s = time.monotonic()
            else:
                await self._start_simulators(stack)
            live.world.hold_traffic()  # until both programs are ready, however long a busy computer takes
            truth = self._truth = TruthLog(log, round(live.start_s * 1e9))
            truth.scene(
                self._built.rig, self._monitors.min_separation_m, dict.fromkeys(Role, 0), live.world.config.target.kind
            )
            self._start_cameras(stack)
            stack.enter_context(open_beacons(rig, self._seed, self._out, live.now_s, live.snapshot))
            stack.enter_context(open_hedges(rig, self._seed, live.now_s, live.snapshot))
            asyncio.get_running_loop().add_reader(sys.stdin.fileno(), self._on_input)
            air = await stack.enter_async_context(Air(self._proxy))
            say({"event": "ready", "air": air.port})
            await self._step_until_finished(truth)
            for role in Role:
                truth.setpoint_gap(role, live.world)
            say(self._findings(truth))

    def _vehicle(self, role: Role) -> MavlinkVehicle | TelloEmulator:
        rig, world = self._rig, self._live.world
        if is_tello(rig.role(role).vehicle):
            emulator, self._videos[role] = tello_of(rig, role, world.drone(role), world.config, self._seed)
            return emulator
        return embedded_vehicle(rig, rig.role(role), world.drone(role))

    async def _start_simulators(self, stack: AsyncExitStack) -> None:
        """Real autopilots fly the drones: the world then follows what their simulators say is true."""
        live, simulated = self._live, dict[Role, SimulatedVehicle]()
        for role in Role:
            config = self._config.simulator(role)
            assert config is not None
            simulated[role] = SimulatedVehicle(self._rig, role, config, self._config, self._out, self._seed)
            stack.callback(simulated[role].close)
        say({"event": "warming", "what": "waiting until the autopilots' simulators can be armed"})
        await start_simulators(simulated)
        self._vehicles.update(simulated)
        live.world = FollowedWorld(self._config, self._seed, simulated)
        live.start_s = time.monotonic()
        for vehicle in simulated.values():
            vehicle.epoch_s = live.start_s

    def _start_cameras(self, stack: AsyncExitStack) -> None:
        rig = self._rig
        for role in Role:
            video = self._videos.get(role)
            writer = stack.enter_context(video or shared_camera(os.environ[RUN_VARIABLE], rig, role))
            rate_hz = video.rate_hz if video is not None else float(camera_config(rig, role).fps)
            picture = CameraView(self._built, role, self._seed, depth=video is None)
            phase = 0.0 if role is Role.SENDER else 0.37
            camera = CameraThread(_Scene(self._live, role), picture, writer, rate_hz, phase)
            self._cameras[role] = camera
            stack.enter_context(running(camera))

    async def _step_until_finished(self, truth: TruthLog) -> None:
        """Physics and both vehicles at 200 Hz, until told to finish and both are down, or that takes too long."""
        live = self._live
        asked_s: float | None = None

        def step(steps: int) -> bool:
            nonlocal asked_s
            now_s = live.now_s()
            with live.lock:
                live.world.advance(max(now_s, live.world.time_s))
                for vehicle in self._vehicles.values():
                    vehicle.pump(live.world.time_s)
                truth.modes(live.world)
                for video in self._videos.values():
                    video.pump(live.start_s + live.world.time_s)
                if steps % TRUTH_STEPS == 0:
                    truth.truth(live.world)
                    self._monitors.on_truth(now_s, live.world.separation_m, live.world.both_in_air)
                    self._monitors.on_target(now_s, clearance(live.world))
                if steps % (TRUTH_STEPS * VEHICLES_EVERY) == 0:  # the roles' phases are in their logs: no S7 here
                    self._monitors.scripts.on_truth(now_s, vehicles_of(live.world, self._built.rig))
            if self._finish_within_s is not None:
                asked_s = now_s if asked_s is None else asked_s
                landed = all(down(live.world, role) for role in Role)
                return landed or now_s - asked_s > self._finish_within_s
            return False

        await at_pace(live.now_s, step)

    def _on_input(self) -> None:
        commands = self._commands.read()
        if commands is None:
            asyncio.get_running_loop().remove_reader(sys.stdin.fileno())
            self._finish_within_s = 0.0 if self._finish_within_s is None else self._finish_within_s
            return
        for command in commands:
            self._obey(command)

    def _obey(self, command: dict[str, Any]) -> None:
        if "finish" in command:
            self._finish_within_s = float(command["finish"])
        elif "begin" in command:
            with self._live.lock:
                self._live.world.begin_traffic()
        else:
            self._inject(command["fault"], float(command["value"]), int(command.get("at_ns", time.monotonic_ns())))

    def _inject(self, name: str, value: float, at_ns: int) -> None:
        live, role = self._live, FAULTS[name].role
        self._truth.fault(name, at_ns)
        with live.lock:
            inject_in_world(name, role, live.world, value or None)
        inject_on_link(name, value, self._proxy)
        if role is None:
            return
        if name == "camera_freeze":
            live.frozen.add(role)
        if name == "fc_link_loss":
            self._vehicles[role].silent = True
        if name.startswith(("kill_", "stop_", "stall_")) or name == "fc_link_loss":
            live.cut_off[role].append(live.now_s())

    def _findings(self, truth: TruthLog) -> dict[str, Any]:
        live, monitors = self._live, self._monitors
        for role in Role:
            vehicle = self._vehicles[role]
            by_sticks = isinstance(vehicle, TelloEmulator)
            sessions = vehicle.sessions if by_sticks else live.world.drone(role).autopilot.offboard_sessions
            monitors.on_offboard(role, sessions, live.cut_off[role])
        for detail in monitors.details:
            truth.violation(live.world.time_s, detail.partition(" ")[0], detail)
        return {
            "event": "finished",
            "landed": {role.value: down(live.world, role) for role in Role},
            "violations": dict(monitors.violations),
            "details": monitors.details,
            "frames": {r.value: {"rendered": c.rendered, "left_out": c.left_out} for r, c in self._cameras.items()},
        }


def main() -> None:
    rig_file, out, seed, errors, *folders = sys.argv[1:]
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides when this process ends
    try:
        rig = with_errors(load_rig(rig_file, [Path(folder) for folder in folders]), errors)
        asyncio.run(SitlWorld(rig, Path(out), int(seed)).run())
    except (SimulatorBroken, PartError) as error:
        say({"event": "failed", "what": str(error)})
        sys.exit(1)


if __name__ == "__main__":
    main()
