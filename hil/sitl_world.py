"""The world of a ``sitl`` run, a process of its own: physics, vehicles on the wire, cameras, the link between.

    python -m hil.sitl_world RIG_FILE RUN_FOLDER SEED

Commands come as lines of JSON on stdin (``{"fault": NAME, "value": X}``, ``{"finish": SECONDS}``), events go out as
lines of JSON on stdout (``ready``, then ``finished`` with the findings). A closed stdin ends it.
"""

from __future__ import annotations

import asyncio
import gc
import json
import os
import signal
import sys
import threading
import time
from collections.abc import Generator
from contextlib import AsyncExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from drivers.interfaces import PartError
from drivers.log import McapLog
from drivers.mavsdk_geodesy import LocalTangent
from drivers.realsense import RealSenseConfig
from drivers.rig import PartSpec, Rig, decode_part
from drivers.rig_file import load_rig
from drivers.tables import RigError, decode_table
from drivers.udp_link import address_of
from hil.air import Air
from hil.autopilot_process import SimulatorBroken
from hil.beacon_pty import open_beacons, open_hedges
from hil.d415 import T_COLOR_DEPTH, depth_camera
from hil.faults import FAULTS
from hil.faulty_link import ProxySide, UdpFaultProxy
from hil.followed_world import FollowedWorld, SimulatedVehicle, start_simulators
from hil.inject import inject_in_world, inject_on_link
from hil.mavlink_vehicle import MavlinkVehicle, MavlinkVehicleConfig
from hil.monitors import Monitors
from hil.preparation import prepare
from hil.render.depth import DepthRenderer
from hil.render.renderer import Renderer
from hil.script_monitor import vehicles_of
from hil.shared_camera import RUN_VARIABLE, SharedCameraWriter
from hil.sim import VEHICLES_EVERY, down, mission_config
from hil.snapshot import Snapshot
from hil.tello_emulator import TelloEmulator
from hil.tello_video import TelloVideo
from hil.tello_world import is_tello, tello_of
from hil.truth_log import TruthLog
from hil.world import World, WorldConfig
from path.messages import Role

STEP_S = 0.005
TRUTH_STEPS = 4
FINISH_POLL_S = 0.1


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


FrameWriter = SharedCameraWriter | TelloVideo


class CameraThread(threading.Thread):
    """Renders one drone's camera at its rate and publishes the frames. A late frame is left out, and counted."""

    def __init__(self, live: LiveWorld, rig: Rig, role: Role, writer: FrameWriter, seed: int) -> None:
        super().__init__(name=f"camera-{role.value}", daemon=True)
        own = rig.role(role)
        self._live, self._role, self._writer = live, role, writer
        self._renderer = Renderer(own.camera, own.mount.T_b_c, own.mount.T_b_v, rig.layout, seed=seed)
        self._depth: DepthRenderer | None = None
        if isinstance(writer, TelloVideo):
            self._rate_hz = writer.rate_hz
        else:
            self._rate_hz = float(camera_config(rig, role).fps)
            self._depth = DepthRenderer(self._renderer, depth_camera(*depth_size(rig, role)), T_COLOR_DEPTH)
        self.ending = threading.Event()
        self.rendered = 0
        self.left_out = 0

    def run(self) -> None:
        live, period_s = self._live, 1.0 / self._rate_hz
        phase_s = 0.0 if self._role is Role.SENDER else 0.37 * period_s  # two cameras are never in step
        frame = 0
        while not self.ending.is_set():
            due_s = phase_s + frame * period_s
            wait_s = due_s - live.now_s()
            if wait_s > 0.0:
                time.sleep(wait_s)
            elif wait_s < -period_s:
                skipped = int(-wait_s / period_s)
                self.left_out += skipped
                frame += skipped
                continue
            if self._role not in live.frozen:
                self._take(frame)
            frame += 1

    def _take(self, frame: int) -> None:
        live = self._live
        with live.lock:
            live.world.advance(max(live.now_s(), live.world.time_s))
            snapshot = live.world.snapshot()
        stamp_ns = round((live.start_s + snapshot.time_s) * 1e9)
        color = self._renderer.render_color(snapshot, self._role, frame)
        if isinstance(self._writer, TelloVideo):
            self._writer.write(stamp_ns, color)
        elif self._depth is not None:
            self._writer.write(stamp_ns, color, self._depth.render(snapshot, self._role, frame))
        self.rendered += 1


class CommandLines:
    """Lines of JSON that come in on a file, each as soon as it is whole.

    Not ``sys.stdin.readline``: of two lines that come at once it would keep the second to itself, and nothing more
    comes in to be told of.
    """

    def __init__(self, file: int) -> None:
        self._file = file
        self._begun = b""

    def read(self) -> list[dict[str, Any]] | None:
        """What has come in since, when there is something to read; None at the end."""
        data = os.read(self._file, 65536)
        if not data:
            return None
        *lines, self._begun = (self._begun + data).split(b"\n")
        return [json.loads(line) for line in lines]


class SitlWorld:
    """One run's world: open it, run it, ask it for its findings."""

    def __init__(self, rig: Rig, out: Path, seed: int) -> None:
        config = decode_table(rig.world, WorldConfig, rig.where("[world]"))
        self._rig, self._out, self._seed, self._config = rig, out, seed, config
        self._live = LiveWorld(World(config, seed), 0.0)
        mission = mission_config(rig)
        self._monitors = Monitors(rig.method, mission.separation.minimum_m, mission.guard)
        self._finish_within_s: float | None = None
        self._commands = CommandLines(sys.stdin.fileno())
        self._vehicles: dict[Role, MavlinkVehicle | TelloEmulator | SimulatedVehicle] = {}
        self._videos: dict[Role, TelloVideo] = {}
        self._cameras: dict[Role, CameraThread] = {}

    async def run(self) -> None:
        rig, live = self._rig, self._live
        prepare(rig, lambda what: say({"event": "warming", "what": what}))
        gc.freeze()  # what is loaded by now stays: a full collection would stop the world for 0.1 s
        async with AsyncExitStack() as stack:
            log = stack.enter_context(McapLog(self._out / "world.mcap"))
            self._proxy = await stack.enter_async_context(UdpFaultProxy(*proxy_sides(rig), self._seed))
            if self._config.sender_simulator is None:
                for role in Role:
                    self._vehicles[role] = self._vehicle(role)
                    stack.callback(self._vehicles[role].close)
                live.start_s = time.monotonic()
            else:
                await self._start_simulators(stack)
            truth = self._truth = TruthLog(log, round(live.start_s * 1e9))
            truth.scene(rig, self._monitors.min_separation_m, dict.fromkeys(Role, 0))
            self._start_cameras(stack)
            stack.enter_context(open_beacons(rig, self._seed, self._out, live.now_s, self._snapshot))
            stack.enter_context(open_hedges(rig, self._seed, live.now_s, self._snapshot))
            asyncio.get_running_loop().add_reader(sys.stdin.fileno(), self._on_input)
            air = await stack.enter_async_context(Air(self._proxy))
            say({"event": "ready", "air": air.port})
            await self._step_until_finished(truth)
            for role in Role:
                truth.setpoint_gap(role, live.world)
            say(self._findings(truth))

    def _vehicle(self, role: Role) -> MavlinkVehicle | TelloEmulator:
        rig = self._rig
        if is_tello(rig.role(role).vehicle):
            world = self._live.world
            emulator, self._videos[role] = tello_of(rig, role, world.drone(role), world.config, self._seed)
            return emulator
        options = rig.role(role).vehicle.options
        guard = rig.role(role).guard
        second = None if guard is None else _listener(str(guard.options["url"]))
        tangent = LocalTangent(rig.origin.latitude_deg, rig.origin.longitude_deg, rig.origin.altitude_m)
        return MavlinkVehicle(
            MavlinkVehicleConfig(int(options["sysid"]), _listener(str(options["url"])), second=second),
            self._live.world.drone(role),
            tangent,
        )

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
        for role in Role:
            writer = stack.enter_context(self._videos.get(role) or self._shared_camera(role))
            camera = CameraThread(self._live, self._rig, role, writer, self._seed)
            self._cameras[role] = camera
            stack.enter_context(_running(camera))

    def _snapshot(self) -> Snapshot:
        live = self._live
        with live.lock:
            live.world.advance(max(live.now_s(), live.world.time_s))
            return live.world.snapshot()

    def _shared_camera(self, role: Role) -> SharedCameraWriter:
        color = self._rig.role(role).camera
        size, fps = (color.width, color.height), camera_config(self._rig, role).fps
        return SharedCameraWriter(os.environ[RUN_VARIABLE], role, size, depth_size(self._rig, role), fps)

    async def _step_until_finished(self, truth: TruthLog) -> None:
        """Physics and both vehicles at 200 Hz, until told to finish and both are down, or that takes too long."""
        live, steps, asked_s = self._live, 0, None
        while True:
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
                if steps % (TRUTH_STEPS * VEHICLES_EVERY) == 0:  # the roles' phases are in their logs: no S7 here
                    self._monitors.scripts.on_truth(now_s, vehicles_of(live.world, self._rig))
            if self._finish_within_s is not None:
                asked_s = now_s if asked_s is None else asked_s
                landed = all(down(live.world, role) for role in Role)
                if landed or now_s - asked_s > self._finish_within_s:
                    return
            steps += 1
            await asyncio.sleep(max(0.0, steps * STEP_S - live.now_s()))
            if live.now_s() > (steps + 2) * STEP_S:  # what was missed is stepped at once, not caught up tick by tick
                steps = int(live.now_s() / STEP_S)

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


def camera_config(rig: Rig, role: Role) -> RealSenseConfig:
    """How the driver of a role is set. Raises RigError when it is another driver."""
    sight = rig.role(role).sight
    camera = PartSpec.from_table(sight.options.get("camera"), f"{sight.where}.camera", sight.base)
    _, config = decode_part(camera)
    if not isinstance(config, RealSenseConfig):
        raise RigError([f"{camera.where}.factory: the world of level sitl draws for drivers.realsense:RealSense only"])
    return config


def depth_size(rig: Rig, role: Role) -> tuple[int, int]:
    """Width and height that the driver asks the depth camera for."""
    color = rig.role(role).camera
    return camera_config(rig, role).depth_size or (color.width, color.height)


def proxy_sides(rig: Rig) -> tuple[ProxySide, ProxySide]:
    """The proxy listens where each role's link believes the other drone to be."""
    ends = [rig.role(role).link.options for role in (Role.SENDER, Role.RECEIVER)]
    sender, receiver = (ProxySide(address_of(end["peer"], "peer"), address_of(end["bind"], "bind")) for end in ends)
    return sender, receiver


def _listener(url: str) -> tuple[str, int]:
    """Where a MAVLink URL listens."""
    parts = urlsplit(url)
    return parts.hostname or "127.0.0.1", parts.port or 0


@contextmanager
def _running(camera: CameraThread) -> Generator[None, None, None]:
    camera.start()
    try:
        yield
    finally:
        camera.ending.set()
        camera.join()


def say(event: dict[str, Any]) -> None:
    """One event to the parent process."""
    print(json.dumps(event), flush=True)


def main() -> None:
    rig_file, out, seed, *folders = sys.argv[1:]
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides when this process ends
    try:
        asyncio.run(SitlWorld(load_rig(rig_file, [Path(folder) for folder in folders]), Path(out), int(seed)).run())
    except (SimulatorBroken, PartError) as error:
        say({"event": "failed", "what": str(error)})
        sys.exit(1)


if __name__ == "__main__":
    main()
