"""The two threads that receive for djitellopy, made so that no packet ends them.

djitellopy has one thread for the state packets of all drones of a program, and one for their
answers. Its own loops end for good at the first packet that is no ASCII or whose number is too
long, and tell nobody: every drone of the program looks lost from then on. These take their place on
the library's class, before its first drone starts the threads. They keep the library's names, by
which ``ended_receivers`` finds either kind.
"""

from __future__ import annotations

import logging
import socket
import threading
from typing import Any, Protocol, runtime_checkable

import djitellopy.tello  # type: ignore[import-untyped]

library: Any = djitellopy.tello

LONGEST_PACKET = 2048
# of the functions that the library runs in its threads
NAMES = ("udp_state_receiver", "udp_response_receiver")

_log = logging.getLogger("drivers.tello.vehicle")


def udp_state_receiver() -> None:
    """Hand every state packet to the drone that it is from, for as long as the process lives."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listening:
        listening.bind(("", library.Tello.STATE_UDP_PORT))
        while True:
            data, host = _received(listening)
            entry = library.drones.get(host)
            if entry is not None:
                _take_state(entry, data)


def _take_state(entry: dict[str, Any], data: bytes) -> None:
    """Read one packet into a drone's entry of djitellopy's table; what cannot be read is counted
    there.
    """
    try:
        entry["state"] = library.Tello.parse_state(data.decode("ascii"))
    except Exception as error:  # whatever it is: it must not end the thread of all drones
        _log.debug("unreadable state packet %r: %s", data, error)
        if isinstance(entry, Counting):
            entry.count_unreadable()


@runtime_checkable
class Counting(Protocol):
    """An entry in djitellopy's table of drones that wants to know of what could not be read."""

    def count_unreadable(self) -> None:
        """Count one state packet. Must not raise."""
        ...


def udp_response_receiver() -> None:
    """Hand every answer to the drone that it is from, for as long as the process lives."""
    while True:
        data, host = _received(library.client_socket)
        entry = library.drones.get(host)
        if entry is not None:
            entry["responses"].append(data)


def _received(listening: socket.socket) -> tuple[bytes, str]:
    """Return the next packet and the host that sent it. Raises OSError, which ends the thread, and
    says so.
    """
    try:
        data, sender = listening.recvfrom(LONGEST_PACKET)
    except OSError as error:
        _log.error("a thread that receives from the drones has ended: %s", error)
        raise
    return data, str(sender[0])


def install() -> None:
    """Have the library run these loops instead of its own. Of no effect once its threads run."""
    library.Tello.udp_state_receiver = staticmethod(udp_state_receiver)
    library.Tello.udp_response_receiver = staticmethod(udp_response_receiver)


def ended_receivers() -> list[str]:
    """Return which of the two threads do not run; before the first drone neither does."""
    running = [thread.name for thread in threading.enumerate()]
    return [name for name in NAMES if not any(name in each for each in running)]
