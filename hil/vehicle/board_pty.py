"""A flight controller in software: the embedded vehicle behind two serial ports, one of which tells
its truth.

It stands for a board on the bench wherever there is none: an unmodified MAVSDK opens the first
port, the harness the second, both pseudo terminals.

    python -m hil.vehicle.board_pty RIG_FILE

puts two of them behind the devices that a rig names, until Ctrl-C; the devices must not be there
yet.
"""

from __future__ import annotations

import contextlib
import math
import socket
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from drivers.mavlink.geodesy import LocalTangent
from drivers.mavlink.transport.frames import take_frames
from drivers.rig.file import load_rig
from drivers.rig.parts import Rig
from drivers.rig.tables import decode_table
from hil.beacons.pty import SerialCable
from hil.vehicle.alone import run_alone
from hil.vehicle.mavlink_vehicle import MavlinkVehicle, MavlinkVehicleConfig
from hil.vehicle.simulators.wire import SERIAL
from hil.world.config import WorldConfig
from hil.world.world import SimDrone, World
from path.messages import Role

TRUTH_S = 0.01


class _End:
    """A serial cable on one side, the vehicle's UDP channel on the other: bytes pass as they
    come.
    """

    def __init__(self, link: Path) -> None:
        self.cable = SerialCable(link)
        self.cable.plug()
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setblocking(False)
        self.socket.bind(("127.0.0.1", 0))
        self._waiting = bytearray()
        self._peer: Any = None

    def pump_out(self) -> None:
        with contextlib.suppress(BlockingIOError):
            while True:
                packet, self._peer = self.socket.recvfrom(2048)
                self.cable.send(packet)

    def pump_in(self) -> None:
        self._waiting += self.cable.received()
        for frame in take_frames(self._waiting):
            if self._peer is not None:
                self.socket.sendto(frame, self._peer)

    def close(self) -> None:
        self.cable.unplug()
        self.socket.close()


class BoardPty:
    """``companion`` and ``truth`` are the two devices. Whoever steps the world calls ``pump`` at
    200 Hz or so.
    """

    def __init__(
        self,
        sysid: int,
        drone: SimDrone,
        leg_m: float,
        tangent: LocalTangent,
        companion: Path,
        truth: Path,
    ) -> None:
        """The paths become links to pseudo terminals. Raises OSError when there are none left."""
        self._drone = drone
        self._leg_m = leg_m
        self._tangent = tangent
        self._ends = _End(companion), _End(truth)
        self._mav: Any = mavlink.MAVLink(
            None,
            srcSystem=sysid,
            srcComponent=mavlink.MAV_COMP_ID_AUTOPILOT1,
        )
        first, second = (end.socket.getsockname() for end in self._ends)
        self.vehicle = MavlinkVehicle(
            MavlinkVehicleConfig(sysid, first, second=second),
            drone,
            tangent,
        )
        self._told_s = -math.inf

    def close(self) -> None:
        self.vehicle.close()
        for end in self._ends:
            end.close()

    def pump(self, now_s: float) -> None:
        for end in self._ends:
            end.pump_in()
        self.vehicle.pump(now_s)
        for end in self._ends:
            end.pump_out()
        if now_s - self._told_s >= TRUTH_S - 1e-6:
            self._told_s = now_s
            self._ends[1].cable.send(self._truth(now_s))

    def _truth(self, now_s: float) -> bytes:
        """Return the truth as PX4's SIH tells it.

        Whole numbers, cut off towards zero; the body's origin where it touches the ground.
        """
        north, east, down = self._drone.true_position_n_m
        down += self._leg_m
        latitude, longitude, altitude = self._tangent.to_global(north, east, down)
        place = int(latitude * 1e7), int(longitude * 1e7), int(altitude * 1e3)
        vn, ve, vd = (int(v * 1e2) for v in self._drone.true_velocity_n_mps)
        attitude = list(self._drone.true_q_n_b)
        message = mavlink.MAVLink_hil_state_quaternion_message(
            int(now_s * 1e6),
            attitude,
            0.0,
            0.0,
            0.0,
            *place,
            vn,
            ve,
            vd,
            0,
            0,
            0,
            0,
            0,
        )
        packet = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        return packet


def boards_of(
    rig: Rig,
    world: World,
    stack: ExitStack,
) -> list[BoardPty]:
    """Return both boards of a rig, behind the devices it names.

    Raises ValueError when it names none, OSError for a real one.
    """
    origin = rig.origin
    tangent = LocalTangent.at(origin)
    boards: list[BoardPty] = []
    for role in Role:
        options = rig.role(role).vehicle.options
        simulator = world.config.simulator(role)
        urls = str(options["url"]), simulator.truth_url if simulator else ""
        companion, truth = (_device(url) for url in urls)
        drone = world.drone(role)
        leg_m = world.config.airframe.leg_m
        boards.append(BoardPty(int(options["sysid"]), drone, leg_m, tangent, companion, truth))
        stack.callback(boards[-1].close)
    return boards


def _device(url: str) -> Path:
    match = SERIAL.fullmatch(url)
    if match is None:
        raise ValueError(f"{url!r} is no serial port")
    device = Path(match[1])
    if device.exists() and not device.is_symlink():
        raise FileExistsError(f"{device} is a real device: name another")
    return device


def main() -> None:
    rig = load_rig(sys.argv[1])
    world = World(decode_table(rig.world, WorldConfig, rig.where("world")), seed=0)
    with ExitStack() as stack, contextlib.suppress(KeyboardInterrupt):
        boards = boards_of(rig, world, stack)
        sys.stdout.write("two boards in software are switched on; Ctrl-C switches them off\n")
        sys.stdout.flush()
        run_alone(world, [board.pump for board in boards])


if __name__ == "__main__":
    main()
