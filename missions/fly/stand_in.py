"""``path-handoff stand-in``: a vehicle, a Tello, a camera or a beacon alone, for programs of others to
be tried against.
"""

from __future__ import annotations

import os
import socket
import sys
import tempfile
from collections.abc import Iterator
from itertools import count as count_from
from itertools import islice
from pathlib import Path
from typing import TextIO

from drivers.interfaces import PartError
from missions.ground.options.flights import StandInOptions
from missions.ground.rig_library import load

STAND_IN = "hil.stand_in"
HIGHEST_PORT = 65535
USUAL = {
    "vehicle": ("sim", 14540),
    "tello": ("sitl-tello", 8899),
    "camera": ("sitl", 5600),
    "hedgehog": ("sim", 0),
}
"""The rig and the port of each kind."""
TELLOS = ("127.0.0.2", "127.0.0.3")
TELLO = "drivers.tello.vehicle:TelloVehicle"


def run(options: StandInOptions, out: TextIO | None = None) -> int:
    """Become the stand-in, until Ctrl-C. Raises PartError for a rig without such a part, or a port
    that cannot be.
    """
    stream = out or sys.stdout
    kind = options.what
    rig = load(options.rig or USUAL[kind][0])
    if rig.level not in ("sim", "sitl"):
        raise PartError(
            f"{rig.name}: its vehicles are of level {rig.level}", "name a rig of level sim or sitl"
        )
    if (rig.sender.vehicle.factory == TELLO) != (kind == "tello") and kind != "camera":
        raise PartError(f"{rig.name}: its drones are no {kind}s", f"name a rig with {kind}s")
    first = options.port or USUAL[kind][1]
    count = 2 if options.two else 1
    if kind == "hedgehog":
        if options.port is not None:
            raise PartError("--port: a hedgehog has a serial port", "leave it out")
        places = list(islice(free_links(), count))
    elif kind == "tello":
        places = [f"{host}:{first}" for host in TELLOS[:count]]
    else:
        places = [str(first + number) for number in range(count)]
        if int(places[-1]) > HIGHEST_PORT:
            raise PartError(f"--port {first}: there is no port {places[-1]}", "name a lower one")
    for number, place in enumerate(places, 1):
        stream.write(told(kind, number, place))
    stream.flush()
    words = [kind, str(rig.file), str(options.seed), *places]
    os.execv(sys.executable, [sys.executable, "-m", STAND_IN, *words])


def told(
    kind: str,
    number: int,
    place: str,
) -> str:
    """Return how a program reaches a stand-in."""
    if kind == "tello":
        host, _, port = place.partition(":")
        return (
            f"Tello {number}: listens on UDP {place}, sends state to 8890 and video to 11111\n"
            f'  djitellopy: tello = Tello("{host}"); tello.address = ("{host}", {port})\n'
        )
    if kind == "hedgehog":
        what = f"hedgehog {number}: Marvelmind's protocol, 500000 baud, on {place}\n"
        return (
            f'{what}  PATH: ports = ["{place}"]   marvelmind.py: MarvelmindHedge(tty="{place}")\n'
        )
    if kind == "camera":
        return (
            f"camera {number}: H.264 to UDP port {place} of this computer\n"
            f'  OpenCV: cv2.VideoCapture("udp://127.0.0.1:{place}")   ffplay udp://127.0.0.1:{place}\n'
        )
    port = int(place)
    return (
        f"vehicle {number}: MAVLink 2 to UDP port {port} of this computer\n{who_is_there(port)}\n"
    )


def free_links() -> Iterator[str]:
    """Yield names for serial ports that no other stand-in has."""
    for number in count_from(1):
        link = Path(tempfile.gettempdir()) / f"path-hedgehog-{number}"
        if not link.exists():  # one that was killed left a link that leads nowhere
            yield str(link)


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
