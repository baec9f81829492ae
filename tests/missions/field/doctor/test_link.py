"""The test of the link on real sockets: both ends at once, one alone, and ends that do not belong
together.
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import pytest

from drivers.link.udp import UdpLink, UdpLinkConfig
from drivers.rig.part_check import Finding
from missions.field.doctor import link as doctor_link
from missions.field.doctor.link import PingExchange, check_link, judged
from path.messages import Pong, Role
from tests.drivers.link.link_ends import Cable, Context, WallClock, serial_links
from tests.free_ports import free_port
from tests.missions.field.doctor.doctor_findings import LIMIT_S, both, found

AHEAD_NS = 5_000_000_000


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, seconds in (("MEASURE_S", 1.5), ("LAST_S", 0.5)):
        monkeypatch.setattr(doctor_link, name, seconds)


class AheadClock:
    def now_ns(self) -> int:
        return WallClock().now_ns() + AHEAD_NS


def ports() -> tuple[int, int]:
    return free_port(), free_port()


def end(role: Role, own: int, peer: int, key: Path | None, clock: Any = None) -> UdpLink:
    config = UdpLinkConfig(f"127.0.0.1:{own}", f"127.0.0.1:{peer}", key)
    return UdpLink(config, Context(role, clock or WallClock()))


def named(findings: list[Finding]) -> dict[str, Finding]:
    return {finding.name: finding for finding in findings}


def test_two_ends_that_look_at_once_measure_each_other(key_file: Path) -> None:
    one, other = ports()
    ahead = AheadClock()
    sender, receiver = (
        end(Role.SENDER, one, other, key_file),
        end(Role.RECEIVER, other, one, key_file, ahead),
    )
    found_both = asyncio.run(
        both(check_link(sender, WallClock(), LIMIT_S), check_link(receiver, ahead, LIMIT_S))
    )
    for findings, offset in zip(found_both, (5.0, -5.0), strict=True):
        every = named(findings)
        assert every["key"].state == every["clocks"].state == every["round trip"].state == "ok", (
            every
        )
        assert every["loss"].state != "fault", every
        told_s = float(every["clocks"].detail.split(" is ")[1].split(" s ")[0])
        assert told_s == pytest.approx(offset, abs=0.02)


def test_an_end_alone_is_a_note_and_says_what_is_known() -> None:
    one, other = ports()
    every = found(check_link(end(Role.SENDER, one, other, None), WallClock(), wait_s=0.2))
    assert every["other end"].state == "note"
    assert "nothing came" in every["other end"].detail
    assert every["key"].state == "note"


def test_another_key_at_the_other_end_is_a_fault(key_file: Path, tmp_path: Path) -> None:
    one, other = ports()
    wrong = tmp_path / "wrong.key"
    wrong.write_bytes(bytes(32))
    wrong.chmod(0o600)
    ends = end(Role.SENDER, one, other, key_file), end(Role.RECEIVER, other, one, wrong)
    for findings in asyncio.run(
        both(*(check_link(each, WallClock(), wait_s=1.5) for each in ends))
    ):
        every = named(findings)
        assert every["packets"].state == "fault"
        assert "bad_signature" in every["packets"].detail
        assert every["other end"].state == "note"


def radios(
    folder: Path, look: Callable[[Cable], list[AsyncIterator[Finding]]]
) -> list[dict[str, Finding]]:
    """Returns the findings at the ends of a pair of pseudo terminals."""

    async def looked() -> list[list[Finding]]:
        cable = Cable(folder)
        cable.plug()
        try:
            return await both(*look(cable))
        finally:
            cable.unplug()

    return [named(findings) for findings in asyncio.run(looked())]


def test_two_ends_of_a_pair_of_radios_measure_each_other(tmp_path: Path, key_file: Path) -> None:
    def look(cable: Cable) -> list[AsyncIterator[Finding]]:
        return [check_link(each, WallClock(), LIMIT_S) for each in serial_links(cable, key_file)]

    for every in radios(tmp_path, look):
        assert every["opens"].state == every["key"].state == every["clocks"].state == "ok", every
        assert every["round trip"].state == "ok" and every["loss"].state != "fault", every
        assert "packets" not in every


def test_radios_that_bring_noise_are_a_fault_that_names_the_baud(
    tmp_path: Path, key_file: Path
) -> None:
    def look(cable: Cable) -> list[AsyncIterator[Finding]]:
        cable.garble()
        return [check_link(each, WallClock(), wait_s=1.5) for each in serial_links(cable, key_file)]

    for every in radios(tmp_path, look):
        assert every["packets"].state == "fault"
        assert "noise" in every["packets"].detail and "baud" in every["packets"].fix
        assert every["other end"].state == "note"


def test_a_radio_that_is_not_plugged_in_ends_the_test(tmp_path: Path, key_file: Path) -> None:
    one, _ = serial_links(Cable(tmp_path), key_file)
    every = found(check_link(one, WallClock(), 0.1))
    assert every[""].state == "fault"
    assert f"serial port {tmp_path / 'one'}" in every[""].detail and "plugged in" in every[""].fix


def test_a_port_in_use_and_a_key_that_others_can_read_end_the_test(key_file: Path) -> None:
    one, other = ports()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", one))
        every = found(check_link(end(Role.SENDER, one, other, None), WallClock(), 0.1))
        assert every[""].state == "fault"
        assert "in use" in every[""].detail
    key_file.chmod(0o644)
    every = found(check_link(end(Role.SENDER, one, other, key_file), WallClock(), 0.1))
    assert every[""].state == "fault"
    assert every[""].fix == f"chmod 600 {key_file}"


@pytest.mark.parametrize(("answered", "state"), [(100, "ok"), (90, "note"), (60, "fault")])
def test_losses_are_judged(answered: int, state: str) -> None:
    exchange = PingExchange(sent=set(range(1, 101)))
    for nonce in range(1, answered + 1):
        sent_ns = nonce * 25_000_000
        exchange.trips_ms[nonce] = 2.0
        exchange.alignment.on_pong(
            Pong(nonce, sent_ns, sent_ns + 1_000_000, sent_ns + 1_000_000), sent_ns + 2_000_000
        )
    every = named(list(judged(exchange, doctor_link.LinkCounters())))
    assert every["loss"].state == state
    assert every["clocks"].state == "ok"
