"""One part without a flight, for any program that speaks its language.

    python -m hil.stand_in vehicle RIG_FILE SEED PORT [PORT]
    python -m hil.stand_in tello RIG_FILE SEED HOST:PORT [HOST:PORT]
    python -m hil.stand_in camera RIG_FILE SEED PORT [PORT]
    python -m hil.stand_in hedgehog RIG_FILE SEED LINK [LINK]

is the rig's sender, and its receiver where there is a second place, until Ctrl-C; a hedgehog, a beacon
on its target, and on the sender.
``path-handoff stand-in`` starts it.
"""

from __future__ import annotations

import contextlib
import math
import signal
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from drivers.mavlink.geodesy import LocalTangent
from drivers.rig.file import load_rig
from drivers.rig.parts import Rig
from drivers.rig.tables import decode_table
from hil.beacons.noise import BeaconConfig
from hil.beacons.pty import SerialCable
from hil.beacons.system import BeaconFrame, BeaconSystem, ByteChunk
from hil.harness.realtime.parts import CameraView
from hil.tello.emulator import TelloEmulator, TelloEmulatorConfig
from hil.tello.video import TelloVideo, TelloVideoConfig
from hil.vehicle.alone import run_alone
from hil.vehicle.mavlink_vehicle import MavlinkVehicle, MavlinkVehicleConfig
from hil.world.config import WorldConfig
from hil.world.errors import as_built
from hil.world.world import World
from path.messages import Role

HOST = "127.0.0.1"
FRAMES_HZ = 15.0
ADDRESSES = (7, 5)  # of the beacons on the target and on D1, as in the rigs


class Film:
    """What a drone's camera sees, drawn and sent while somebody wants it."""

    def __init__(
        self,
        rig: Rig,
        role: Role,
        seed: int,
        world: World,
    ) -> None:
        camera = rig.role(role).camera
        self.video = TelloVideo(TelloVideoConfig(camera.width, camera.height, FRAMES_HZ), seed)
        self._view = CameraView(as_built(rig, seed), role, seed, depth=False)
        self._world = world
        self._frame = 0
        self._draw()  # kernels are loaded before anybody waits for an answer

    def pump(self, now_s: float) -> None:
        """Draw a frame that is due, and send those that are."""
        if self.video.wanted and now_s * FRAMES_HZ >= self._frame:
            self._frame = math.floor(now_s * FRAMES_HZ) + 1
            self._draw()
        self.video.pump(time.monotonic())

    def _draw(self) -> None:
        self._view.take(time.monotonic_ns(), self._world.snapshot(), self._frame, self.video)


class Hedgehog:
    """A beacon on the target, or on D1, behind a serial port; its frame is east, north, up."""

    def __init__(
        self,
        number: int,
        link: Path,
        seed: int,
        world: World,
    ) -> None:
        self.cable = SerialCable(link)
        self.cable.plug()
        name = "target" if number == 0 else "sender"
        aligned = BeaconFrame(0.0, np.zeros(3))
        addresses = {name: ADDRESSES[number]}
        self._system = BeaconSystem(BeaconConfig(), seed, addresses, surveyed=aligned)
        self._turns = self._system.turns(0.0)
        self._turn_s = 0.0
        self._world = world
        self._due: deque[ByteChunk] = deque()
        self._name = name

    def pump(self, now_s: float) -> None:
        """Sound, when it is its turn, and send what is due."""
        if now_s >= self._turn_s:
            snapshot = self._world.snapshot()
            target_m = np.array(snapshot.objects[0].position_w_m)
            place_m = target_m if self._name == "target" else snapshot.drones[Role.SENDER].T_w_b.t
            self._due.append(self._system.hear(self._name, now_s, place_m))
        while now_s >= self._turn_s:  # what a busy computer missed is left out
            self._turn_s, _ = next(self._turns)
        while self._due and self._due[0].arrives_s <= now_s:
            self.cable.send(self._due.popleft().data)


def parts_of(
    kind: str,
    rig: Rig,
    seed: int,
    world: World,
    places: list[str],
    stack: ExitStack,
) -> Iterator[Callable[[float], None]]:
    """Yield what is pumped of each stand-in, closed with the stack. Raises OSError for a port that
    is taken.
    """
    for number, (role, place) in enumerate(zip(Role, places, strict=False)):
        if kind == "hedgehog":
            hedgehog = Hedgehog(number, Path(place), seed, world)
            stack.callback(hedgehog.cable.unplug)
            yield hedgehog.pump
            continue
        drone = world.drone(role)
        if kind == "vehicle":
            config = MavlinkVehicleConfig(number + 1, (HOST, int(place)))
            vehicle = MavlinkVehicle(config, drone, LocalTangent.at(rig.origin))
            stack.callback(vehicle.close)
            yield vehicle.pump
            continue
        film = Film(rig, role, seed, world)
        if kind == "camera":
            film.video.start(HOST, (HOST, int(place)))
            stack.callback(film.video.stop)
        else:
            host, _, port = place.partition(":")
            heading_rad = math.radians(world.config.home(role).heading_deg)
            own = TelloEmulatorConfig(host, int(port), home_yaw_rad=heading_rad)
            tello = TelloEmulator(own, drone, film.video)
            stack.callback(tello.close)
            yield tello.pump
        yield film.pump


def main() -> None:
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    kind = sys.argv[1]
    rig = load_rig(sys.argv[2])
    seed = int(sys.argv[3])
    world = World(decode_table(rig.world, WorldConfig, rig.where("world")), seed)
    with ExitStack() as stack, contextlib.suppress(KeyboardInterrupt):
        parts = list(parts_of(kind, rig, seed, world, sys.argv[4:], stack))
        sys.stdout.write("switched on; Ctrl-C switches off\n")
        sys.stdout.flush()
        run_alone(world, parts)


if __name__ == "__main__":
    main()
