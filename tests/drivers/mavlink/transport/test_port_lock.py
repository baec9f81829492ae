"""Who has a port or a device: one program of ours, and nobody else beside it."""

from __future__ import annotations

import os
import socket
from pathlib import Path

import pytest

from drivers.interfaces import VehicleError
from drivers.mavlink.transport.port_lock import PortLock
from tests.free_ports import free_port


@pytest.fixture(autouse=True)
def own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Locks of these tests are nobody else's."""
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(tmp_path))
    return tmp_path


URLS = (
    "udpin://127.0.0.1:1",
    "serial:///dev/ttyACM0:57600",
    "tcpout://10.0.0.2:5760",
    "udpout://10.0.0.2:1",
)


@pytest.mark.parametrize("url", URLS)
def test_what_one_program_has_no_other_one_gets_until_it_is_given_back(
    url: str, own_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def nobody(*_: object) -> None: ...

    monkeypatch.setattr("drivers.mavlink.transport.port_lock._probe", nobody)
    with PortLock(url) as held:
        (file,) = own_folder.iterdir()
        assert file.read_text() == f"{os.getpid()}\n"
        with pytest.raises(VehicleError, match=rf"already used by .*process {os.getpid()}\)"):
            PortLock(url)
        held.release()
        held.release()  # it was given back already
        with PortLock(url):
            pass
    other = PortLock(url)
    other.release()


def test_two_devices_have_two_locks() -> None:
    with PortLock("serial:///dev/ttyACM0:57600"), PortLock("serial:///dev/ttyACM1:57600"):
        pass


def test_the_number_of_an_earlier_program_does_not_stay_behind(own_folder: Path) -> None:
    PortLock("serial:///dev/ttyA:57600").release()
    (file,) = own_folder.iterdir()
    file.write_text("12345678901234567890\n")
    with PortLock("serial:///dev/ttyA:57600"):
        assert file.read_text() == f"{os.getpid()}\n"


@pytest.mark.parametrize(
    ("scheme", "kind", "shown"),
    [
        ("udp", socket.SOCK_DGRAM, "ss -lunp"),
        ("udpin", socket.SOCK_DGRAM, "ss -lunp"),
        ("tcpin", socket.SOCK_STREAM, "ss -ltnp"),
    ],
)
def test_a_port_that_another_program_listens_on_is_refused_with_how_to_find_it(
    scheme: str, kind: socket.SocketKind, shown: str
) -> None:
    with socket.socket(socket.AF_INET, kind) as other:
        other.bind(("127.0.0.1", 0))
        if kind is socket.SOCK_STREAM:
            other.listen()
        port = other.getsockname()[1]
        with pytest.raises(VehicleError) as caught:
            PortLock(f"{scheme}://127.0.0.1:{port}")
        named = "UDP" if kind is socket.SOCK_DGRAM else "TCP"
        assert str(caught.value).startswith(f"{named} port {port} is already in use")
        assert f"{shown} 'sport = :{port}'" in caught.value.remedy
    with PortLock(f"{scheme}://127.0.0.1:{port}"):  # nothing is left of the refusal
        pass


def test_where_nobody_is_listened_to_nothing_is_probed() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        with PortLock(f"udpout://127.0.0.1:{other.getsockname()[1]}"):
            pass


def test_an_address_of_another_computer_cannot_be_listened_on() -> None:
    with pytest.raises(VehicleError, match=r"cannot listen on 192.0.2.1"):
        PortLock(f"udpin://192.0.2.1:{free_port()}")


@pytest.mark.parametrize(
    "url", ["", "udpin://127.0.0.1", "http://127.0.0.1:1", "serial:///dev/x:fast"]
)
def test_what_is_no_connection_is_refused_with_how_to_write_one(url: str) -> None:
    with pytest.raises(VehicleError, match=r"is no MAVLink connection"):
        PortLock(url)
