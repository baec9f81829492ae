"""Hearing from a person's tablet, a tag's receiver or another program by UDP: one line of JSON a
datagram.

Whoever says something is asked back for a while. Only programs on this computer are heard unless
the rig says so: nothing here is signed, and who points decides what is followed.
"""

from __future__ import annotations

import asyncio
import ipaddress
from collections.abc import Sequence
from typing import Self

from drivers.interfaces import LinkError
from drivers.link.end import LinkContext
from drivers.link.udp import Address, address_of
from drivers.operator.interfaces import Chosen, Question, Told
from drivers.operator.words import MOST_BYTES, WordsError, decode, encode_question
from path.values import frozen

ASKED_FOR_S = 10.0  # whoever was heard so lately is asked
WAITING = 256  # statements between two turns; older ones are of no use


@frozen
class UdpOperatorConfig:
    """The ``[sender.operator]`` table of a rig.

    Attributes:
        bind: own end, ``host:port`` with a numeric host.
        allow_unsigned: hear other computers too. Then keep the network closed: nothing is signed.
    """

    bind: str = "127.0.0.1:47041"
    allow_unsigned: bool = False

    def __post_init__(self) -> None:
        host, _ = address_of(self.bind, "bind")
        if not (ipaddress.ip_address(host).is_loopback or self.allow_unsigned):
            raise ValueError(
                "bind: other computers could say which object is meant (or allow_unsigned = true)"
            )


class UdpOperator:
    """Implements ``drivers.operator.interfaces.Operator``.

    ``refused``: how often something was heard that could not be understood, by what was wrong.
    """

    Config = UdpOperatorConfig

    def __init__(self, config: UdpOperatorConfig, context: LinkContext) -> None:
        self._bind = address_of(config.bind, "bind")
        self._clock = context.clock
        self._transport: asyncio.DatagramTransport | None = None
        self._said: list[Told | Chosen] = []
        self._heard_ns: dict[Address, int] = {}
        self._question: tuple[Question, bytes | None] | None = None
        self.refused: dict[str, int] = {}

    async def __aenter__(self) -> Self:
        loop = asyncio.get_running_loop()
        try:
            transport, _ = await loop.create_datagram_endpoint(
                lambda: _Ear(self), local_addr=self._bind
            )
        except OSError as error:
            host, port = self._bind
            raise LinkError(
                f"operator: cannot listen at {host}:{port}: {error.strerror}", "name another port"
            ) from error
        self._transport = transport
        return self

    async def __aexit__(self, *_: object) -> None:
        if self._transport is not None:
            self._transport.close()
            self._transport = None

    def heard(self) -> Sequence[Told | Chosen]:
        """Return all that was said since the last call."""
        said = self._said
        self._said = []
        return said

    def ask(self, question: Question | None, picture: bytes | None) -> None:
        """Show a question to everybody who was heard lately, and to whoever comes in while it is
        open.
        """
        self._question = None if question is None else (question, picture)
        for address in self._listeners():
            self._tell(address)

    def take(self, line: bytes, address: Address) -> None:
        """Take up one datagram."""
        now_ns = self._clock.now_ns()
        try:
            told = decode(line[:MOST_BYTES], now_ns)
        except WordsError as error:
            what = str(error)
            if what in self.refused or len(self.refused) < WAITING:
                self.refused[what] = self.refused.get(what, 0) + 1
            return
        known = address in self._listeners()
        self._heard_ns[address] = now_ns
        if told is not None and len(self._said) < WAITING:
            self._said.append(told)
        if told is None or not known:
            self._tell(address)

    def _listeners(self) -> list[Address]:
        oldest_ns = self._clock.now_ns() - round(ASKED_FOR_S * 1e9)
        self._heard_ns = {address: ns for address, ns in self._heard_ns.items() if ns >= oldest_ns}
        return list(self._heard_ns)

    def _tell(self, address: Address) -> None:
        if self._transport is None:
            return
        question, picture = (None, None) if self._question is None else self._question
        self._transport.sendto(encode_question(question, self._clock.now_ns(), picture), address)


class _Ear(asyncio.DatagramProtocol):
    def __init__(self, operator: UdpOperator) -> None:
        self._operator = operator

    def datagram_received(self, data: bytes, addr: Address) -> None:
        self._operator.take(data, addr)

    def error_received(self, exc: Exception) -> None:
        """Nobody listens where a question was sent: nothing depends on it."""
