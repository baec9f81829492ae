"""One Tello behind an unmodified djitellopy, with typed edges and answers that belong to the
command they came for.

djitellopy does the sockets, the state packets and the video container. Its blocking commands are
not used: they wait in ``time.sleep`` for seconds, resend motion, and take whatever answer comes
next for their own, a late one included.

Its two receiving threads are made with a process's first drone and live as long as the process;
what they run is ours (``receivers``). Their sockets are the library's own.

A drone's command port also sends packets of its app's binary protocol. They are no answers, and
neither is what has no letter or digit in it: both are passed over and counted, and the answer is
waited for.
"""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from collections.abc import Callable
from typing import Any

from drivers.interfaces import Clock, VehicleError
from drivers.mavlink.telemetry import ThreadClock
from drivers.tello.address import (
    STOCK_STATE_PORT,
    STOCK_VIDEO_PORT,
    TelloAddress,
    check_namespace,
    check_ports,
    check_route,
)
from drivers.tello.receivers import ended_receivers, install, library
from drivers.tello.state import TelloReport, read_report

POLL_S = 0.01
LATE_S = 7.0  # djitellopy's own patience: what was not answered by then is not waited for any more
COMMAND_TRIES = 3  # of "command", which starts no motion
COMMAND_S = 1.0
STATE_S = 2.0
DRAIN_S = 0.5  # for answers to the earlier ones of several "command"
APP_PACKET = 0xCC  # first byte of the app's protocol

_log = logging.getLogger("drivers.tello.vehicle")
_open: dict[str, TelloLink] = {}  # by host: camera and vehicle of a drone share one
_state_port: list[int] = []  # that the library of this process listens on


class _TelloSlot(dict[str, Any]):
    """Stands in djitellopy's table of drones: tells when a state packet or an answer came."""

    def __init__(self, link: TelloLink) -> None:
        self.answers = _Answers()
        super().__init__(responses=self.answers, state={})
        self._link = link

    def __setitem__(self, key: str, value: Any) -> None:
        super().__setitem__(key, value)
        if key == "state":
            self._link.on_state(value)

    def count_unreadable(self) -> None:
        """Count a state packet that is none, on the receiving thread."""
        self._link.bad_reports += 1


class _Answers(list[bytes]):
    """djitellopy's list of answers of one drone, with their arrival."""

    def __init__(self) -> None:
        super().__init__()
        self._lock = threading.Lock()

    def append(self, data: bytes) -> None:
        with self._lock:
            super().append(data)

    def take(self) -> list[bytes]:
        with self._lock:
            taken = list(self)
            self.clear()
            return taken


class TelloLink:
    """Opened with ``acquire``, closed with ``release``. Methods belong to the event loop and raise
    VehicleError.

    Attributes:
        report: the newest state packet; ``bad_reports`` counts those that could not be read.
        on_report: called with every state packet, on the library's thread.
        late: answers that came after their command had been given up, counted.
        passed_over: packets on the command port that are no answers, counted.
    """

    def __init__(self, address: TelloAddress, clock: Clock) -> None:
        self.address = address
        self.clock = ThreadClock(clock)
        self.report: TelloReport | None = None
        self.bad_reports = 0
        self.late = 0
        self.passed_over = 0
        self.on_report: Callable[[TelloReport], None] | None = None
        self.tello: Any = None
        self._slot: _TelloSlot | None = None
        self._users = 0
        self._asking = asyncio.Lock()
        # commands without an answer yet, and when they were given up
        self._owed: list[tuple[str, float]] = []
        self._sent_s = time.monotonic()

    @property
    def silent_s(self) -> float:
        """Since anything was sent to the drone."""
        return time.monotonic() - self._sent_s

    @property
    def deaf(self) -> str:
        """Which receiving thread has ended, in words; empty while both run."""
        return ", ".join(ended_receivers())

    def report_age_s(self) -> float:
        self.clock.follow()
        return (
            (self.clock.now_ns() - self.report.arrival_ns) * 1e-9
            if self.report is not None
            else float("inf")
        )

    def send(self, command: str) -> None:
        """One datagram, no answer expected. Never blocks."""
        if self.tello is None:
            raise VehicleError("the drone is not connected", "open it first")
        self._sent_s = time.monotonic()
        try:
            self.tello.send_command_without_return(command)
        except OSError as error:
            raise VehicleError(
                f"cannot send to {self.address.host}: {error.strerror}",
                "is its Wi-Fi still connected?",
            ) from error

    async def ask(self, command: str, timeout_s: float, urgent: bool = False) -> str | None:
        """Send a command once and wait for its own answer; None when none came that is certainly
        its.

        Answers carry no name. While an earlier command is still owed one, an ordinary command waits
        until that came or will not come any more; an ``urgent`` one goes at once, and takes only
        what comes beyond what is owed.
        """
        async with self._asking:
            if not urgent:
                await self._settle()
            self._take_late()
            self.send(command)
            answered = False
            end_s = time.monotonic() + timeout_s
            try:
                while time.monotonic() < end_s:
                    for data in self._answers():
                        if self._owed:
                            self._note_late(data)
                        else:
                            answered = True
                            return data.decode().strip()
                    await asyncio.sleep(POLL_S)
                return None
            finally:
                if not answered:  # also when nobody waits any more
                    self._owed.append((command, time.monotonic()))

    async def _settle(self) -> None:
        while self._owed:
            self._take_late()
            self._owed = [each for each in self._owed if time.monotonic() - each[1] < LATE_S]
            if self._owed:
                await asyncio.sleep(POLL_S)

    def _take_late(self) -> None:
        for data in self._answers():
            self._note_late(data)

    def _note_late(self, data: bytes) -> None:
        self.late += 1
        command = self._owed.pop(0)[0] if self._owed else "nothing"
        _log.warning("%s: %r came too late, as the answer to %s", self.address.host, data, command)

    def _answers(self) -> list[bytes]:
        """Return the answers that came since the last time, without what is none."""
        came = self._slot.answers.take() if self._slot is not None else []
        answers = [data for data in came if is_answer(data)]
        self.passed_over += len(came) - len(answers)
        return answers

    def on_state(self, fields: dict[str, Any]) -> None:
        """Take a state packet on the receiving thread; must not raise there."""
        report = read_report(fields, self.clock.now_ns())
        if report is None:
            self.bad_reports += 1
            return
        self.report = report
        if self.on_report is not None:
            self.on_report(report)

    # --- opening and closing ---

    async def acquire(self) -> None:
        """Connect, or join who is connected already."""
        if self._users == 0:
            await self._connect()
        self._users += 1

    async def release(self) -> None:
        self._users -= 1
        if self._users == 0:
            self._forget()

    def _forget(self) -> None:
        """Forgets the drone without the library's ``end``.

        That would land a drone that it believes to fly, seven seconds long.
        """
        host = self.address.host
        if self._slot is not None and library.drones.get(host) is self._slot:
            del library.drones[host]
        if _open.get(host) is self:
            del _open[host]
        self.tello = None
        self._slot = None

    async def _connect(self) -> None:
        address = self.address
        self.clock.follow()
        check_namespace(address.namespace)
        check_route(address)
        check_ports(address, _state_port[0] if _state_port else None)
        self.tello = self._make()
        try:
            await self._enter_sdk_mode()
            await self._set_ports()
            await self._await_state()
            await self._check_serial()
        except BaseException:
            self._forget()
            raise

    def _make(self) -> Any:
        install()
        address = self.address
        tello = library.Tello
        tello.LOGGER.setLevel(logging.ERROR)  # it writes every setpoint to stderr
        tello.CONTROL_UDP_PORT = 0  # the drone answers to whatever port it was asked from
        tello.STATE_UDP_PORT = address.state_port
        made = tello(address.host, retry_count=1, vs_udp=address.video_port)
        made.address = (address.host, address.command_port)
        if not _state_port:
            _state_port.append(address.state_port)
        self._slot = _TelloSlot(self)
        library.drones[address.host] = self._slot
        _open[address.host] = self
        return made

    async def _enter_sdk_mode(self) -> None:
        """Say "command" until an "ok" to any of them comes: it moves nothing, and they all ask for
        the same.
        """
        host = self.address.host
        for tried in range(COMMAND_TRIES):
            self._owed.clear()
            answer = await self.ask("command", COMMAND_S, urgent=True)
            if answer is None:
                continue
            if answer.lower() == "ok":
                if tried > 0:
                    await asyncio.sleep(DRAIN_S)
                    self._take_late()
                return
            raise VehicleError(
                f"the drone at {host} refused SDK mode: it said {answer!r}", "restart the drone"
            )
        unread = f" but {self.passed_over} packets that are no answers" if self.passed_over else ""
        raise VehicleError(
            f"no answer from {host}:{self.address.command_port}{unread} in {COMMAND_TRIES * COMMAND_S:g} s",
            "is the drone on, and this computer in its Wi-Fi (docs/tello.md)?",
        )

    async def _set_ports(self) -> None:
        address = self.address
        if (address.state_port, address.video_port) == (STOCK_STATE_PORT, STOCK_VIDEO_PORT):
            return
        answer = await self.ask(f"port {address.state_port} {address.video_port}", COMMAND_S)
        if answer is None or answer.lower() != "ok":
            raise VehicleError(
                f"the drone at {address.host} does not send to other ports: {said(answer)}",
                "only a firmware with SDK 3 does; others need a network namespace each and the stock ports "
                "(docs/tello.md)",
            )

    async def _await_state(self) -> None:
        end_s = time.monotonic() + STATE_S
        while self.report is None:
            if time.monotonic() >= end_s:
                unread = (
                    f" that can be read ({self.bad_reports} cannot)" if self.bad_reports else ""
                )
                raise VehicleError(
                    f"{self.address.host} answers, but no state packet{unread} came to UDP port "
                    f"{self.address.state_port} in {STATE_S:g} s",
                    "does a firewall keep it away, or another program take it? (`ss -lunp` shows who listens)",
                )
            await asyncio.sleep(POLL_S)

    async def _check_serial(self) -> None:
        wanted = self.address.serial
        if not wanted:
            return
        found = await self.ask("sn?", COMMAND_S)
        if found != wanted:
            raise VehicleError(
                f"the drone at {self.address.host} is {found or 'of unknown serial number'}, the rig says {wanted}",
                "the two drones' Wi-Fi networks may be swapped",
            )


def is_answer(data: bytes) -> bool:
    """Return whether a packet from the command port is an answer in words.

    The app's binary packets begin with 0xCC; a few of them are UTF-8 by chance, with control
    characters inside.
    """
    if not data or data[0] == APP_PACKET:
        return False
    try:
        text = data.decode().strip()
    except UnicodeDecodeError:
        return False
    return text.isprintable() and any(each.isalnum() for each in text)


def said(answer: str | None) -> str:
    return "it did not answer" if answer is None else f"it said {answer!r}"


def link_to(address: TelloAddress, clock: Clock) -> TelloLink:
    """The link to a drone: the one that is open in this process, or a new one. Raises VehicleError
    when they differ.
    """
    existing = _open.get(address.host)
    if existing is None:
        return TelloLink(address, clock)
    for name in ("state_port", "video_port", "command_port"):
        if getattr(existing.address, name) != getattr(address, name):
            raise VehicleError(
                f"{name}: {getattr(address, name)} here, but {getattr(existing.address, name)} where the same drone "
                f"({address.host}) was opened",
                "give its vehicle and its camera the same address in the rig",
            )
    return existing
