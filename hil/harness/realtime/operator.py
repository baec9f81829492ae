"""The person of ``hil.world.operator`` beside a world in real time: talks to D1's program by UDP,
as a tablet does.
"""

from __future__ import annotations

import json
import socket
from contextlib import suppress
from typing import Any

from drivers.link.udp import address_of
from drivers.operator.udp import UdpOperatorConfig
from drivers.rig.parts import Rig
from drivers.rig.tables import decode_table
from hil.world.errors import Built
from hil.world.operator import Answer, Person, PersonConfig, Pointed
from hil.world.snapshot import Snapshot
from path.messages import Role
from path.observations import Box

HELLO_S = 2.0
MOST_BYTES = 1 << 16


class PersonOnTheWire:
    """Says by UDP what the person says, and shows it what is asked. Nothing here waits."""

    def __init__(self, person: Person, address: tuple[str, int]) -> None:
        self._person = person
        self._address = address
        self._socket = socket.socket(
            socket.AF_INET6 if ":" in address[0] else socket.AF_INET, socket.SOCK_DGRAM
        )
        self._socket.setblocking(False)
        self._hello_s = 0.0
        self._asked: set[int] = set()

    def close(self) -> None:
        """Leave."""
        self._socket.close()

    def pump(self, snapshot: Snapshot) -> None:
        """Say and hear what there is."""
        for said in self._person.says(snapshot):
            self._send(_words(said))
        if snapshot.time_s >= self._hello_s:
            self._hello_s = snapshot.time_s + HELLO_S
            self._send({"hello": True})
        while (line := self._receive()) is not None:
            self._hear(json.loads(line), snapshot)

    def _hear(self, asked: dict[str, Any], snapshot: Snapshot) -> None:
        number = asked["asks"]
        if number is None or number in self._asked:
            return
        self._asked.add(number)
        shown = [(each["number"], Box(*each["box"])) for each in asked["objects"]]
        self._person.is_asked(number, shown, asked["age_s"], snapshot)

    def _send(self, words: dict[str, Any]) -> None:
        with suppress(OSError):  # D1's program does not listen yet, or any more
            self._socket.sendto(json.dumps(words).encode(), self._address)

    def _receive(self) -> bytes | None:
        try:
            return self._socket.recv(MOST_BYTES)
        except OSError:
            return None


def _words(said: Pointed | Answer) -> dict[str, Any]:
    if isinstance(said, Answer):
        return {"question": said.question, "number": said.number}
    height = {} if said.down_m is None else {"down_m": said.down_m}
    return {"place": said.place_m, "error_m": said.error_m, **height}


def person_on_the_wire(
    rig: Rig,
    built: Built,
    config: PersonConfig,
    seed: int,
) -> PersonOnTheWire | None:
    """Return the person that D1's program hears; None where the rig has no operator."""
    spec = rig.sender.operator
    if spec is None:
        return None
    heard = decode_table(spec.options, UdpOperatorConfig, spec.where, spec.base)
    return PersonOnTheWire(Person(config, built, Role.SENDER, seed), address_of(heard.bind, "bind"))
