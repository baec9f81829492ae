"""The world of a relay in real time, a process of its own.

It has drones by name, each with its vehicle on the wire and its camera while it is switched on; the link of the leg
under way; and the monitors.

    python -m hil.harness.relay_sitl_world RIG_FILE DRONES SEED ERRORS [FOLDER ...]

Commands come in on stdin as lines of JSON: ``{"on": NAME}``, ``{"camera_off": NAME}``, ``{"off": NAME}``, ``{"leg": N,
"sender": NAME, "receiver": NAME}``, ``{"died": NAME, "at_ns": T}``, ``{"fault": ...}``, ``{"finish": SECONDS}``, and
what drones' programs logged, ``{"event": "record", "record": [NAME, TOPIC, STAMP_NS, RECORD]}``. Events go out on
stdout: ``warming``, ``ready``, ``landed`` whenever that changes, and at last ``finished`` with the findings. A closed
stdin ends it.
"""

from __future__ import annotations

import asyncio
import gc
import os
import signal
import sys
import time
from contextlib import AsyncExitStack, ExitStack
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from drivers.interfaces import PartError
from drivers.log.json_lines import JsonLines
from drivers.rig.file import load_rig
from drivers.rig.parts import Rig, RoleRig, with_errors
from drivers.rig.tables import decode_table
from flight.harness.relay import RelayConfig, pair_of
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
from hil.harness.relay_live import HINDSIGHT_S, Hindsight, LiveRelay, RelayScene, run_of
from hil.harness.relay_world import OTHER, OWN, RelayWorld
from hil.harness.sim import mission_config
from hil.link.faulty import LinkFaults, UdpFaultProxy
from hil.monitors.claims import in_world_time
from hil.monitors.monitors import LEASES
from hil.monitors.relay import RelayMonitors
from hil.vehicle.mavlink_vehicle import MavlinkVehicle
from hil.world.errors import as_built
from hil.world.world import WorldConfig

TRUTH_STEPS = 4
VEHICLES_STEPS = 200


@dataclass(slots=True)
class _WorldDrone:
    """One drone in the world: its vehicle while it is switched on, its camera while a program may look."""

    own: RoleRig
    pair: Rig
    picture: CameraView
    phase: float
    vehicle: MavlinkVehicle | None = None
    camera: ExitStack = field(default_factory=ExitStack)
    cut_off_s: list[float] = field(default_factory=list[float])


class RelaySitlWorld:
    """One relay's world: open it, run it, ask it for its findings."""

    def __init__(self, rig: Rig, config: RelayConfig, seed: int) -> None:
        world_config = decode_table(rig.world, WorldConfig, rig.where("[world]"))
        self._rig, self._config, self._seed = rig, config, seed
        self._live = LiveRelay(RelayWorld(world_config, seed, config.drones))
        self._pairs = {drone.name: pair_of(rig, drone, drone) for drone in config.drones}
        self._built = {
            name: as_built(pair, seed, {OTHER: 0, OWN: k}) for k, (name, pair) in enumerate(self._pairs.items())
        }
        owns = {name: built.rig.receiver for name, built in self._built.items()}
        self._monitors = RelayMonitors(rig, config, mission_config(rig), self._live.world, owns)
        self._hindsight = Hindsight(self._monitors)
        self._commands = JsonLines(sys.stdin.fileno())
        self._drones: dict[str, _WorldDrone] = {}
        self._proxies: dict[int, UdpFaultProxy] = {}
        self._orders: asyncio.Queue[dict[str, Any]] = asyncio.Queue()
        self._landed: dict[str, bool] = {}
        self._finish_within_s: float | None = None

    async def run(self) -> None:
        live = self._live
        prepare(self._rig, lambda what: say({"event": "warming", "what": what}))
        for k, (name, pair) in enumerate(self._pairs.items()):
            picture = CameraView(self._built[name], OWN, self._seed * 64 + k, depth=True)
            self._drones[name] = _WorldDrone(pair.receiver, pair, picture, phase=0.37 * k % 1.0)
        gc.freeze()  # what is loaded by now stays: a full collection would stop the world for 0.1 s
        async with AsyncExitStack() as stack:
            stack.push_async_callback(self._close)
            live.start_s = time.monotonic()
            asyncio.get_running_loop().add_reader(sys.stdin.fileno(), self._on_input)
            say({"event": "ready"})
            tasks = asyncio.ensure_future(at_pace(live.now_s, self._step)), asyncio.ensure_future(self._obey_in_order())
            for task in tasks:
                stack.callback(task.cancel)
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                task.result()  # an order that cannot be carried out ends the world
            say(self._findings())

    # --- stepping ---

    def _step(self, steps: int) -> bool:
        live, world, hindsight = self._live, self._live.world, self._hindsight
        now_s = live.now_s()
        with live.lock:
            world.advance(max(now_s, world.time_s))
            for drone in self._drones.values():
                if drone.vehicle is not None:
                    drone.vehicle.pump(world.time_s)
            if steps % TRUTH_STEPS == 0:
                self._monitors.on_truth(world.time_s)
                hindsight.remember(world.time_s, (world.truth(), world.objects))
            if steps % VEHICLES_STEPS == 0:
                hindsight.put(world.time_s, "on_vehicles", world.time_s, self._monitors.vehicles())
                hindsight.put(world.time_s, "sample", world.time_s, world.batteries, world.airborne)
            landed = {name: world.landed(name) for name in world.names}
        hindsight.judge(now_s - HINDSIGHT_S)
        if landed != self._landed:
            self._landed = landed
            say({"event": "landed", "landed": landed})
        if self._finish_within_s is None:
            return False
        return all(landed.values()) or now_s > self._finish_within_s

    # --- commands ---

    def _on_input(self) -> None:
        commands = self._commands.read()
        if commands is None:
            asyncio.get_running_loop().remove_reader(sys.stdin.fileno())
            self._finish_within_s = 0.0
            return
        for command in commands:
            if "record" in command:
                self._on_record(*command["record"])
            else:
                self._orders.put_nowait(command)

    def _on_record(self, name: str, topic: str, stamp_ns: int, record: dict[str, Any]) -> None:
        epoch_ns = round(self._live.start_s * 1e9)
        seen = in_world_time(record, epoch_ns) if topic in LEASES else record
        stamp_w_ns = stamp_ns - epoch_ns
        self._hindsight.put(stamp_w_ns * 1e-9, "on_record", name, topic, stamp_w_ns, seen)

    async def _obey_in_order(self) -> None:
        while True:
            command = await self._orders.get()
            now_s = self._live.now_s()
            match command:
                case {"on": name}:
                    self._switch_on(name, now_s)
                case {"camera_off": name}:
                    await self._close_camera(name)
                case {"off": name}:
                    await self._close_camera(name)
                    self._switch_off(name)
                case {"leg": number, "sender": sender, "receiver": receiver}:
                    await self._open_leg(number, sender, receiver)
                case {"died": name, "at_ns": at_ns}:
                    self._hindsight.put(at_ns * 1e-9 - self._live.start_s, "on_death", name)
                case {"fault": name, "leg": leg, "drone": drone, "value": value, "at_ns": at_ns}:
                    self._inject(name, leg, drone, value, at_ns * 1e-9 - self._live.start_s)
                case {"finish": seconds}:
                    self._finish_within_s = now_s + seconds
                case _:
                    raise ValueError(f"the world knows no command {command}")

    def _switch_on(self, name: str, now_s: float) -> None:
        """Its autopilot and its camera; what is on already stays so."""
        live, drone = self._live, self._drones[name]
        with live.lock:
            if name not in live.world.on:
                live.world.switch_on(name)
                self._monitors.on_switched_on(name, now_s)
                drone.vehicle = embedded_vehicle(self._rig, drone.own, live.world.drone(name))
        writer = drone.camera.enter_context(shared_camera(run_of(os.environ[RUN_VARIABLE], name), drone.pair, OWN))
        rate_hz = float(camera_config(drone.pair, OWN).fps)
        drone.camera.enter_context(
            running(CameraThread(RelayScene(live, name), drone.picture, writer, rate_hz, drone.phase))
        )

    async def _close_camera(self, name: str) -> None:
        """Its thread may be drawing: the vehicles do not wait for that."""
        await asyncio.to_thread(self._drones[name].camera.close)

    def _switch_off(self, name: str) -> None:
        live = self._live
        with live.lock:
            self._close_flight(name, live.now_s())
            live.world.swap(name)
        live.frozen.discard(name)
        live.others.pop(name, None)

    def _close_flight(self, name: str, now_s: float) -> None:
        """Closes one flight: its autopilot's record goes to the monitors before it is started anew."""
        drone = self._drones[name]
        self._monitors.on_offboard(name, drone.cut_off_s)
        self._monitors.on_swap(name, now_s)
        drone.cut_off_s = []
        if drone.vehicle is not None:
            drone.vehicle.close()
            drone.vehicle = None

    async def _open_leg(self, number: int, sender: str, receiver: str) -> None:
        """A link of their own; it takes the place of any that either had."""
        for proxy in self._proxies.values():
            await proxy.__aexit__(None, None, None)
        sides = [proxy_side(self._drones[name].own) for name in (sender, receiver)]
        self._proxies = {number: UdpFaultProxy(sides[0], sides[1], self._seed * 4096 + number, LinkFaults())}
        await self._proxies[number].__aenter__()
        live = self._live
        live.others[sender], live.others[receiver] = receiver, sender
        now_s = live.now_s()
        self._hindsight.put(now_s, "on_leg", number, sender, receiver)

    def _inject(self, name: str, leg: int, drone: str | None, value: float | None, at_s: float) -> None:
        live = self._live
        if leg in self._proxies:
            inject_on_link(name, value or 0.0, self._proxies[leg])
        with live.lock:
            inject_in_world(name, drone, live.world, value)
        if drone is None:
            return
        vehicle = self._drones[drone].vehicle
        if name == "camera_freeze":
            live.frozen.add(drone)
        if name == "fc_link_loss" and vehicle is not None:
            vehicle.silent = True
        if name.startswith(("kill_", "stop_", "stall_")) or name == "fc_link_loss":
            self._drones[drone].cut_off_s.append(at_s)

    # --- the end ---

    async def _close(self) -> None:
        for drone in self._drones.values():
            drone.camera.close()
            if drone.vehicle is not None:
                drone.vehicle.close()
        for proxy in self._proxies.values():
            await proxy.__aexit__(None, None, None)

    def _findings(self) -> dict[str, Any]:
        live, monitors = self._live, self._monitors
        self._hindsight.judge(float("inf"))
        now_s = live.now_s()
        aloft = [name for name, landed in self._landed.items() if not landed]
        for name in self._drones:
            self._close_flight(name, now_s)
        monitors.close()
        found = monitors.findings()
        return {
            "event": "finished",
            **found,
            "flown": [asdict(each) for each in found["flown"]],
            "samples": [asdict(each) for each in found["samples"]],
            "watched": [asdict(each) for each in found["watched"]],
            "simulated_s": now_s,
            "aloft": aloft,
        }


def drones_of(rig: Rig, number: int) -> RelayConfig:
    """The rig's relay with its first drones."""
    config = decode_table(rig.relay, RelayConfig, rig.where("[relay]"), rig.file.parent)
    return replace(config, drones=config.drones[:number])


def main() -> None:
    rig_file, drones, seed, errors, *folders = sys.argv[1:]
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides when this process ends
    try:
        rig = with_errors(load_rig(rig_file, [Path(folder) for folder in folders]), errors)
        asyncio.run(RelaySitlWorld(rig, drones_of(rig, int(drones)), int(seed)).run())
    except PartError as error:
        say({"event": "failed", "what": str(error)})
        sys.exit(1)


if __name__ == "__main__":
    main()
