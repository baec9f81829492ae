"""Rerun's own program, for this computer alone: its window, or the page that it serves from its
package.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Generator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from drivers.interfaces import PartError

HOST = "127.0.0.1"
UP_S = 60.0


def _program() -> list[str]:
    return [sys.executable, "-m", "rerun"]


def window(rrd: Path) -> int:
    return subprocess.run(
        [*_program(), str(rrd), "--bind", HOST, "--port", "auto"], check=False
    ).returncode


def serve(rrd: Path, port: int) -> int:
    """Serve the page until Ctrl-C. Raises PartError when the port is taken."""
    with suppress(KeyboardInterrupt), page(port, str(rrd)) as (server, _):
        return server.wait()
    return 0


@contextmanager
def page(port: int, *arguments: str) -> Generator[tuple[subprocess.Popen[bytes], str], None, None]:
    """Rerun's server of the page, and where it takes what is to be shown. Ctrl-C ends it. Raises
    PartError.
    """
    _refuse_taken(port)
    own = _free_port()
    ports = ["--serve-web", "--bind", HOST, "--web-viewer-port", str(port), "--port", str(own)]
    with _until_end([*_program(), *arguments, *ports]) as server:
        _until_up(server, port)
        sys.stdout.write(
            f"http://{HOST}:{port}/?url=rerun%2Bhttp://{HOST}:{own}/proxy    (Ctrl-C ends it)\n"
        )
        sys.stdout.flush()
        yield server, f"rerun+http://{HOST}:{own}/proxy"


@contextmanager
def viewer() -> Generator[tuple[subprocess.Popen[bytes], str], None, None]:
    """Rerun's window."""
    own = _free_port()
    with _until_end(
        [*_program(), "--bind", HOST, "--port", str(own), "--expect-data-soon"]
    ) as server:
        _until_up(server, own)
        yield server, f"rerun+http://{HOST}:{own}/proxy"


@contextmanager
def _until_end(command: Sequence[str]) -> Generator[subprocess.Popen[bytes], None, None]:
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # the server ends with this program
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, start_new_session=True) as server:
        try:
            yield server
        finally:
            with suppress(ProcessLookupError):
                # Rerun's package starts its program as a child of its own
                os.killpg(server.pid, signal.SIGTERM)


def _until_up(server: subprocess.Popen[bytes], port: int) -> None:
    end_s = time.monotonic() + UP_S
    while time.monotonic() < end_s and server.poll() is None:
        with socket.socket() as probe:
            if probe.connect_ex((HOST, port)) == 0:
                return
        time.sleep(0.1)
    raise PartError(
        "Rerun's server did not come up", "see what it said above; name another port with --port"
    )


def _refuse_taken(port: int) -> None:
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, port))
        except OSError as error:
            raise PartError(
                f"port {port}: {error.strerror}", "name another one with --port"
            ) from error


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return int(probe.getsockname()[1])
