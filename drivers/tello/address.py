"""The address of a Tello and its needs of this computer, checked before anything is sent to it."""

from __future__ import annotations

import errno
import fcntl
import ipaddress
import socket
import struct
from pathlib import Path
from typing import Annotated

from drivers.interfaces import VehicleError
from path.bounds import Bounds
from path.values import frozen

STOCK_STATE_PORT = 8890
STOCK_VIDEO_PORT = 11111
SIOCGIFADDR = 0x8915


@frozen
class TelloAddress:
    """The address of a drone, and the ports that its packets come to. Two drones on one computer:
    docs/tello.md.

    Attributes:
        host: the drone's address; 192.168.10.1 while it is its own access point.
        state_port, video_port: of this computer; others than 8890 and 11111 need a drone that knows
            ``port`` (SDK 3).
        interface: network interface that the drone must be reached through; empty: whichever.
        namespace: network namespace that this program must run in (``ip netns exec NAME``); empty:
            whichever.
        serial: what the drone must answer to ``sn?``; empty: any drone.
        command_port: of the drone.
    """

    host: str = "192.168.10.1"
    state_port: Annotated[int, Bounds(1, 65535, "(a port)")] = STOCK_STATE_PORT
    video_port: Annotated[int, Bounds(1, 65535, "(a port)")] = STOCK_VIDEO_PORT
    interface: str = ""
    namespace: str = ""
    serial: str = ""
    command_port: Annotated[int, Bounds(1, 65535, "(a port)")] = 8889

    def __post_init__(self) -> None:
        try:
            ipaddress.IPv4Address(self.host)
        except ValueError:
            raise ValueError(
                f'host: {self.host!r} is no IPv4 address, such as "192.168.10.1"'
            ) from None
        for name in ("state_port", "video_port", "command_port"):
            if not 1024 < getattr(self, name) < 65536:
                raise ValueError(f"{name}: {getattr(self, name)} is not within 1025..65535")
        if self.state_port == self.video_port:
            raise ValueError(f"video_port: {self.video_port} is the state packets' already")


def check_ports(address: TelloAddress, listening: int | None) -> None:
    """Raise VehicleError when a port is taken: the library would fail in a thread, where nobody
    hears it.

    ``listening``: the port on which djitellopy takes state packets in this program already.
    """
    if listening is not None and listening != address.state_port:
        raise VehicleError(
            f"state_port: this program listens on {listening} already, not on {address.state_port}",
            "djitellopy takes state packets of all drones of one program on one port",
        )
    ports = [] if listening is not None else [("state_port", address.state_port)]
    for name, port in [*ports, ("video_port", address.video_port)]:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("", port))
            except OSError as error:
                if error.errno != errno.EADDRINUSE:
                    raise VehicleError(
                        f"{name}: cannot listen on UDP port {port}: {error.strerror}"
                    ) from error
                raise VehicleError(
                    f"{name}: UDP port {port} is in use",
                    f"end the other program (`ss -lunp 'sport = :{port}'` names it); two drones with stock ports need "
                    "a network namespace each (docs/tello.md)",
                ) from error


def check_namespace(name: str) -> None:
    """Raise VehicleError when this program does not run in the network namespace of that name."""
    if not name:
        return
    wanted = Path("/run/netns") / name
    try:
        same = wanted.stat().st_ino == Path("/proc/self/ns/net").stat().st_ino
    except OSError as error:
        raise VehicleError(
            f"namespace: there is no network namespace {name!r} ({error.strerror})",
            "make it as docs/tello.md says",
        ) from error
    if not same:
        raise VehicleError(
            f"namespace: this program does not run in network namespace {name!r}",
            f"start it with `ip netns exec {name} path-handoff ...` (docs/tello.md)",
        )


def check_route(address: TelloAddress) -> None:
    """Raise VehicleError when there is no way to the drone, or another than the interface that the
    rig names.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect((address.host, address.command_port))
        except OSError as error:
            raise VehicleError(
                f"no route to {address.host}: {error.strerror}",
                "connect this computer to the drone's Wi-Fi",
            ) from error
        own = str(probe.getsockname()[0])
        if not address.interface:
            return
        try:
            packed = fcntl.ioctl(
                probe.fileno(),
                SIOCGIFADDR,
                struct.pack("256s", address.interface.encode()[:15]),
            )
            theirs = socket.inet_ntoa(packed[20:24])
        except OSError as error:
            raise VehicleError(
                f"interface: {address.interface} has no address ({error.strerror})",
                f"`ip address show {address.interface}`: is it there, and connected to the drone's Wi-Fi?",
            ) from error
    if own != theirs:
        raise VehicleError(
            f"interface: {address.host} is reached from {own}, which is not {address.interface} ({theirs})",
            "two drones have the same address: give each interface a network namespace of its own (docs/tello.md)",
        )
