"""``path-handoff stand-in``: an embedded vehicle alone, for programs of others to be tried against."""

from __future__ import annotations

import os
import socket
import sys
from typing import TextIO

from drivers.interfaces import PartError
from missions.ground.options.flights import StandInOptions
from missions.ground.rig_library import load

STAND_IN = "hil.stand_in"
HIGHEST_PORT = 65535


def run(options: StandInOptions, out: TextIO | None = None) -> int:
    """Become the stand-in, until Ctrl-C. Raises PartError for a rig without a simulated vehicle, or
    a port that cannot be.
    """
    stream = out or sys.stdout
    rig = load(options.rig)
    if rig.level not in ("sim", "sitl"):
        raise PartError(
            f"{rig.name}: its vehicles are of level {rig.level}", "name a rig of level sim or sitl"
        )
    ports = [options.port, options.port + 1] if options.two else [options.port]
    if ports[-1] > HIGHEST_PORT:
        raise PartError(f"--port {options.port}: there is no port {ports[-1]}", "name a lower one")
    for number, port in enumerate(ports):
        stream.write(f"vehicle {number + 1}: MAVLink 2 to UDP port {port} of this computer\n")
        stream.write(f"{who_is_there(port)}\n")
    stream.flush()
    words = [str(rig.file), str(options.seed), *map(str, ports)]
    os.execv(sys.executable, [sys.executable, "-m", STAND_IN, *words])


def who_is_there(port: int) -> str:
    """Return how a program listens on a port, or that one does already."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
            return "  a program listens there already"
    return (
        f"  MAVSDK: udpin://127.0.0.1:{port}   pymavlink: udpin:127.0.0.1:{port}\n"
        f"  MAVProxy: --master=udp:127.0.0.1:{port}   QGroundControl listens on 14550 by itself"
    )
