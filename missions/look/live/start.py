"""``--live``: starts the process that serves a flight's logs, beside the flight, and ends it after
it. What the operator may do on its page is said here (``Operated``), and calling the flight off is
done here: as Ctrl-C does it.
"""

from __future__ import annotations

import json
import os
import secrets
import select
import signal
import subprocess
import sys
import threading
import time
import webbrowser
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path

from drivers.interfaces import PartError
from drivers.rig.parts import Rig
from missions.ground.heard_by import is_heard, operator_of
from missions.ground.shown import tell_line
from missions.look.live.gate import LOOPBACK, TOKEN
from path.messages import Role
from path.values import frozen

EXAMPLE = "127.0.0.1:8765"
MIN_TOKEN = 16
# a busy computer begins a program slowly; one that dies is told at once
UP_S = 120.0
END_S = 8.0


@frozen
class Operated:
    """What can be done about a flight from its page.

    Attributes:
        operator: host and port of D1's program for what it is told; None: nobody hears by UDP.
        stops: what calling it off does, in words.
    """

    operator: tuple[str, int] | None
    stops: str


def both(rig: Rig) -> Operated:
    """A flight of both drones from one command."""
    return Operated(_heard(rig), "both drones end the hand-over and land")


EVERY = Operated(None, "every drone ends what it does, and lands")
"""A relay or a team, whose drones are told their targets otherwise."""


def one(rig: Rig, role: Role) -> Operated:
    """One drone's side, on its own companion."""
    mine = "this drone ends the hand-over and lands; the other one hears of it"
    return Operated(_heard(rig) if role is Role.SENDER else None, mine)


def _heard(rig: Rig) -> tuple[str, int] | None:
    return operator_of(rig) if is_heard(rig) else None


@contextmanager
def live(
    asked: str | None,
    folder: Path,
    operated: Operated | None = None,
) -> Generator[None, None, None]:
    """Serve the logs in a folder while something flies; None: the page only watches. Raises
    PartError when that cannot begin.
    """
    if asked is None:
        yield
        return
    host, port = address_of(asked)
    token = os.environ.get(TOKEN) or secrets.token_urlsafe(MIN_TOKEN)
    can = {"operator": operated and operated.operator, "stops": operated.stops if operated else ""}
    server = subprocess.Popen(
        [sys.executable, "-m", "missions.look.live.serve", str(folder), host, str(port), json.dumps(can)],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True,
        env={**os.environ, TOKEN: token},
    )  # fmt: skip
    obeying = threading.Thread(target=_obey, args=(server,), daemon=True)
    try:
        _until_up(server, asked)
        _say(host, port, token)
        obeying.start()
        yield
    finally:
        _end(server)
        if obeying.ident is not None:
            obeying.join()
        assert server.stdout is not None
        server.stdout.close()


def _obey(server: subprocess.Popen[bytes]) -> None:
    """Call the flight off when its page says so: once, as Ctrl-C does."""
    assert server.stdout is not None
    with suppress(OSError, ValueError):
        for line in server.stdout:
            if line.strip() == b"stop":
                tell_line("CALLED OFF on the live page: the flight ends as by Ctrl-C")
                os.kill(os.getpid(), signal.SIGINT)
                return


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
            f"export {TOKEN}=$(openssl rand -hex 16), and open http://{host}:{number}/?token=...; "
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


def _say(
    host: str,
    port: int,
    token: str,
) -> None:
    """Print the page's link where it is found again, and open it where there is a screen."""
    other = "" if host == LOOPBACK else " (whoever knows the token can watch and act; unencrypted)"
    shown = token if host == LOOPBACK else f"${TOKEN}"
    lines = (
        f"LIVE PAGE{other}:",
        f"    http://{host}:{port}/?token={shown}",
        f"    for Foxglove, Lichtblick: ws://{host}:{port}"
        + ("" if host == LOOPBACK else f"/?token=${TOKEN}"),
    )
    rule = "=" * 60
    tell_line("\n".join((rule, *lines, rule)))
    if sys.stdout.isatty() and has_screen():
        webbrowser.open(f"http://{host}:{port}/?token={token}")


def has_screen() -> bool:
    """Return whether a browser would have somewhere to open its window."""
    named = any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
    return named or sys.platform in ("darwin", "win32")


def _end(server: subprocess.Popen[bytes]) -> None:
    """Let it pass on the rest; never wait longer than some seconds."""
    assert server.stdin is not None
    with suppress(OSError):
        server.stdin.close()
    end_s = time.monotonic() + END_S
    while server.poll() is None and time.monotonic() < end_s:
        time.sleep(0.05)
    if server.poll() is None:
        server.kill()
        server.wait()
