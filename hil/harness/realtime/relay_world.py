"""The world of a relay or a team in real time: drones that are switched on and off by name, and
links leg by leg.

    python -m hil.harness.realtime.relay_world RIG_FILE SEED ERRORS DRONES TARGETS HOURS -- [FOLDER
    ...]

Besides what every world is told: ``{"on": NAME}``, ``{"camera_off": NAME}``, ``{"off": NAME}``,
``{"open": N, "sender": NAME, "receiver": NAME}``, ``{"close": N, "sender": ..., "receiver": ...}``,
``{"died": NAME, "at_ns": T}``, ``{"over": NAME, "at_ns": T}``, ``{"assign": NAME, "target": K}``,
``{"given_up": K}``, and what drones' programs logged, ``{"event": "record", "record": [NAME, TOPIC,
STAMP_NS, RECORD]}``. It says ``landed`` whenever that changes, and now and then ``targets``, where
they are in truth.
"""

from __future__ import annotations

import asyncio
import math
import os
import time
from collections import defaultdict
from collections.abc import Mapping
from contextlib import AsyncExitStack
from dataclasses import asdict, replace
from typing import Any

from drivers.rig.parts import Rig
from flight.harness.fleet import RelayConfig, TeamConfig, relay_of_rig, team_of_rig
from hil.camera.shared import RUN_VARIABLE
from hil.harness.field import make_field
from hil.harness.inject import inject_in_leg
from hil.harness.realtime.pace import frame_age_s, overload_of
from hil.harness.realtime.parts import (
    CameraView,
    camera_config,
    embedded_vehicle,
    proxy_side,
    say,
    shared_camera,
)
from hil.harness.realtime.world import TRUTH_STEPS, RealTimeWorld, main
from hil.link.faulty import LinkFaults, UdpFaultProxy
from hil.monitors.claims import in_world_time
from hil.monitors.hindsight import HINDSIGHT_S, Hindsight
from hil.monitors.monitors import LEASES
from hil.monitors.setpoints import LATE, Late, all_explained, judged, late_of, told_with
from hil.world.snapshot import Snapshot
from hil.world.world import OWN, Fleet

VEHICLES_STEPS = 200
TARGETS_STEPS = 40


def run_of(run: str, name: str) -> str:
    """Return the name of a drone's camera frames, for its program and the world."""
    return f"{run}-{name}"


class RelaySitlWorld(RealTimeWorld):
    """One relay's world, or a team's."""

    def __init__(self, rig: Rig, seed: int, drones: str, targets: str, hours: str) -> None:
        config = field_of(rig, int(drones), int(targets))
        named = config.targets if isinstance(config, TeamConfig) else ()
        super().__init__(rig, [drone.name for drone in config.drones])
        self._seed = seed
        field = self._field = make_field(rig, config, named, seed, float(hours))
        self._world = field.world
        self._pairs = field.pairs
        self._monitors = field.monitors
        self._numbers = range(len(named))
        self._hindsight = Hindsight(self._monitors)
        self._ends: dict[int, tuple[str, str]] = {}  # of the legs that have a link
        self._others: dict[str, str] = {}  # who is in whose picture: the other drone of its leg
        self._landed: dict[str, bool] = {}
        self._late: defaultdict[str, list[Late]] = defaultdict(list)
        # of some frames, when a program took them up
        self._ages_s: defaultdict[str, list[float]] = defaultdict(list)

    @property
    def fleet(self) -> Fleet:
        return self._world

    async def open(self, stack: AsyncExitStack) -> Mapping[str, Any]:
        del stack  # everybody is off
        self._pictures = {
            name: CameraView(built, OWN, self._seed * 64 + k, depth=True)
            for k, (name, built) in enumerate(self._field.built.items())
        }
        self.start_s = time.monotonic()
        return {}

    def seen_by(self, name: str) -> Snapshot:
        return self._world.view(name, self._others.get(name))

    # --- stepping ---

    def watch(self, steps: int, now_s: float) -> None:
        world = self._world
        hindsight = self._hindsight
        if steps % TRUTH_STEPS == 0:
            self._monitors.on_truth(world.time_s)
            hindsight.put(world.time_s, "on_watched", world.time_s)
            hindsight.remember(world.time_s, (world.truths(), world.all_objects))
        if steps % VEHICLES_STEPS == 0:
            hindsight.put(world.time_s, "on_vehicles", world.time_s, self._monitors.vehicles())
            hindsight.put(world.time_s, "sample", world.time_s, world.batteries, world.airborne)
        if steps % TARGETS_STEPS == 0 and len(self._numbers) > 1:
            things = [world.target(number) for number in self._numbers]
            where = [(*thing.position_w_m[:2], thing.yaw_rad, thing.speed_mps) for thing in things]
            say({"event": "targets", "at_s": self.start_s + world.time_s, "where": where})

    def after_step(self, now_s: float) -> None:
        self._hindsight.judge(now_s - HINDSIGHT_S)
        landed = {name: self._world.landed(name) for name in self._world.names}
        if landed != self._landed:
            self._landed = landed
            batteries = dict(zip(self._world.names, self._world.batteries, strict=True))
            say({"event": "landed", "landed": landed, "batteries": batteries})

    def landed(self) -> bool:
        return all(self._world.landed(name) for name in self._world.names)

    # --- commands ---

    def record(self, name: str, topic: str, stamp_ns: int, record: dict[str, Any]) -> None:
        epoch_ns = round(self.start_s * 1e9)
        self._ages_s[name] += frame_age_s(topic, record)
        seen = in_world_time(record, epoch_ns) if topic in LEASES else record
        stamp_w_ns = stamp_ns - epoch_ns
        if topic == LATE:
            self._late[name].append(late_of(record, stamp_w_ns * 1e-9))
            return
        self._hindsight.put(stamp_w_ns * 1e-9, "on_record", name, topic, stamp_w_ns, seen)

    async def obey(self, order: Mapping[str, Any]) -> None:
        now_s = self.now_s()
        put = self._hindsight.put
        match order:
            case {"on": name}:
                self._switch_on(name, now_s)
            case {"camera_off": name}:
                # the vehicles do not wait for its thread
                await asyncio.to_thread(self.drones[name].close_camera)
            case {"off": name, "battery": battery}:
                await asyncio.to_thread(self.drones[name].close_camera)
                self._switch_off(name, battery)
            case {"open": number, "sender": sender, "receiver": receiver}:
                await self._open_leg(number, sender, receiver)
            case {"close": _, "sender": sender, "receiver": receiver}:
                with self.lock:
                    self._world.uncover(sender, receiver)
            case {"died": name, "at_ns": at_ns}:
                put(at_ns * 1e-9 - self.start_s, "on_death", name)
            case {"over": name, "at_ns": at_ns}:
                put(at_ns * 1e-9 - self.start_s, "on_over", name)
            case {"assign": name, "target": target}:
                put(now_s, "on_assigned", name, target)
            case {"given_up": target, "at_ns": at_ns}:
                put(at_ns * 1e-9 - self.start_s, "on_given_up", target)
            case _:
                await super().obey(order)

    def _switch_on(self, name: str, now_s: float) -> None:
        """Its autopilot and its camera; what is on already stays so."""
        drone = self.drones[name]
        pair = self._pairs[name]
        with self.lock:
            if name not in self._world.on:
                self._world.switch_on(name)
                self._monitors.on_switched_on(name, now_s)
                drone.vehicle = embedded_vehicle(
                    self.rig, pair.receiver, self._world.drone(name), self.when_s
                )
        writer = shared_camera(run_of(os.environ[RUN_VARIABLE], name), pair, OWN)
        phase = 0.37 * self._world.names.index(name) % 1.0
        self.start_camera(
            name, self._pictures[name], writer, float(camera_config(pair, OWN).fps), phase
        )

    def _switch_off(self, name: str, battery: float) -> None:
        with self.lock:
            self._close_flight(name, self.now_s())
            self._world.swap(name, battery)
        self.frozen.discard(name)
        self._others.pop(name, None)

    def _close_flight(self, name: str, now_s: float) -> None:
        drone = self.drones[name]
        self._field.end_flight(name, drone.cut_off_s, now_s)
        drone.close_vehicle()

    async def _open_leg(self, number: int, sender: str, receiver: str) -> None:
        """A link of their own; it takes the place of any that either had."""
        for leg, drones in list(self._ends.items()):
            if {sender, receiver} & set(drones):
                await self.proxies.pop(leg).__aexit__(None, None, None)
                del self._ends[leg]
        sides = [proxy_side(self._pairs[name].receiver) for name in (sender, receiver)]
        proxy = UdpFaultProxy(sides[0], sides[1], self._seed * 4096 + number, LinkFaults())
        self.proxies[number], self._ends[number] = proxy, (sender, receiver)
        await proxy.__aenter__()
        self._others[sender], self._others[receiver] = receiver, sender
        self._hindsight.put(self.now_s(), "on_leg", number, sender, receiver)

    def inject(self, order: Mapping[str, Any], at_s: float) -> None:
        del at_s
        ends = order["ends"]
        target = self._monitors.target_of(ends[0])
        inject_in_leg(order["fault"], order["drone"], self._world, order["value"], ends, target)

    # --- the end ---

    def findings(self) -> dict[str, Any]:
        monitors = self._monitors
        world = self._world
        self._hindsight.judge(math.inf)
        now_s = self.now_s()
        aloft = [name for name in world.names if not world.landed(name)]
        for name in self.drones:
            self._close_flight(name, now_s)
        found = monitors.findings()
        many = {
            name: [asdict(each) for each in found[name]] for name in ("flown", "samples", "watched")
        }
        pictures = {name: drone.frames for name, drone in self.drones.items()}
        gaps = [judged(gap, self._late[gap.who], self.stalls) for gap in monitors.gaps]
        late = overload_of(self._ages_s, pictures, stood_s=self.stood_s, gaps=gaps)
        notes = told_with(found["notes"], gaps)
        explained = ["S8"] if all_explained(found["violations"], gaps) else []
        told = {"overload": late, "notes": notes, "explained": explained}
        return {**found, **many, "simulated_s": now_s, "aloft": aloft, **told}


def field_of(rig: Rig, drones: int, targets: int) -> RelayConfig:
    """The rig's relay with its first drones, or its team with its first drones and targets."""
    if rig.team:
        team = team_of_rig(rig)
        return replace(team, drones=team.drones[:drones], targets=team.targets[:targets])
    relay = relay_of_rig(rig)
    return replace(relay, drones=relay.drones[:drones])


if __name__ == "__main__":
    main(RelaySitlWorld)
