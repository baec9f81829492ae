"""The page that Rerun serves: there while it is looked at, and gone with the program."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import pytest

from tests.free_ports import free_port

UP_S, DOWN_S = 120.0, 60.0


def is_up(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


@pytest.mark.parametrize("sign", [signal.SIGINT, signal.SIGTERM])
def test_nothing_is_left_of_the_page(run_folder: Path, sign: signal.Signals) -> None:
    port = free_port(socket.SOCK_STREAM)
    command = [
        sys.executable,
        "-m",
        "missions.cli",
        "view",
        str(run_folder),
        "--web",
        "--port",
        str(port),
    ]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as view:
        try:
            assert view.stdout is not None
            assert f"http://127.0.0.1:{port}/?url=" in view.stdout.readline()
            opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
            with opener.open(f"http://127.0.0.1:{port}/", timeout=UP_S) as page:
                assert b"Rerun" in page.read()
        finally:
            view.send_signal(sign)
            code = view.wait(DOWN_S)
    assert code == 0
    end_s = time.monotonic() + DOWN_S
    while is_up(port) and time.monotonic() < end_s:
        time.sleep(0.1)
    assert not is_up(port)
