"""``--live``: starts the process that serves a flight's logs, beside the flight, and ends it after
it.
"""

from __future__ import annotations

import os
import select
import subprocess
import sys
import time
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path

from drivers.interfaces import PartError
from missions.ground.shown import tell_line
from missions.look.live.gate import LOOPBACK, TOKEN

EXAMPLE = "127.0.0.1:8765"
MIN_TOKEN = 16
# a busy computer begins a program slowly; one that dies is told at once
UP_S = 120.0
END_S = 8.0


@contextmanager
def live(asked: str | None, folder: Path) -> Generator[None, None, None]:
    """Serve the logs in a folder while something flies. Raises PartError when that cannot begin."""
    if asked is None:
        yield
        return
    host, port = address_of(asked)
    server = subprocess.Popen(
        [sys.executable, "-m", "missions.look.live.serve", str(folder), host, str(port)],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True,
    )  # fmt: skip
    try:
        _until_up(server, asked)
        _say(host, port)
        yield
    finally:
        _end(server)


def address_of(asked: str) -> tuple[str, int]:
    """Host and port. Raises PartError, also for another host than loopback without a token."""
    host, colon, number = asked.rpartition(":")
    if not colon or not host or not number.isdecimal() or not 0 < int(number) < 65536:
        raise PartError(f"--live {asked}: no address", f"write it as HOST:PORT, such as {EXAMPLE}")
    host = LOOPBACK if host == "localhost" else host
    if host != LOOPBACK and len(os.environ.get(TOKEN, "")) < MIN_TOKEN:
        raise PartError(
            f"--live {asked}: other computers may only watch with a token, and {TOKEN} has none of {MIN_TOKEN} "
            "characters or more",
            f"export {TOKEN}=$(openssl rand -hex 16), and watch with ws://{host}:{number}/?token=...; "
            f"or --live {EXAMPLE} for this computer alone",
        )
    return host, int(number)


def _until_up(server: subprocess.Popen[bytes], asked: str) -> None:
    assert server.stdout is not None
    ready, _, _ = select.select([server.stdout], [], [], UP_S)
    if not ready or not server.stdout.readline().startswith(b"up"):
        raise PartError(
            f"--live {asked}: could not be served", "see what was said above; name another port"
        )


def _say(host: str, port: int) -> None:
    if host == LOOPBACK:
        tell_line(
            f"live: ws://{host}:{port} (Foxglove, Lichtblick, or path-handoff view --live {host}:{port})"
        )
        return
    tell_line(
        f"LIVE TO OTHER COMPUTERS: whoever knows {TOKEN} can watch at ws://{host}:{port}/?token=..., unencrypted"
    )


def _end(server: subprocess.Popen[bytes]) -> None:
    """Let it pass on the rest; never wait longer than some seconds."""
    assert server.stdin is not None and server.stdout is not None
    with suppress(OSError):
        server.stdin.close()
    end_s = time.monotonic() + END_S
    while server.poll() is None and time.monotonic() < end_s:
        time.sleep(0.05)
    if server.poll() is None:
        server.kill()
        server.wait()
    server.stdout.close()
