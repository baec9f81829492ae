"""Who looks at the live page without a browser: hears what is so, and taps.

    python -m tests.missions.look.live.watcher PORT TOKEN

is one of several that only look, for ever.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from http.client import HTTPConnection
from typing import Any

HOST = "127.0.0.1"
UP_S = 120.0
BETWEEN_S = 0.5  # two taps


def hears(port: int, token: str) -> Iterator[dict[str, Any]]:
    """Yield what is so of the flight, until the server ends. Raises AssertionError when there is
    none.
    """
    end_s = time.monotonic() + UP_S
    while True:
        line = HTTPConnection(HOST, port, timeout=30.0)
        with suppress(ConnectionRefusedError):
            line.request("GET", f"/events?token={token}")
            break
        assert time.monotonic() < end_s, "no page"
        time.sleep(0.1)
    name = b""
    with suppress(OSError):
        for told in line.getresponse():
            if told.startswith(b"event: "):
                name = told[7:].strip()
            elif told.startswith(b"data: ") and name == b"now":
                yield json.loads(told[6:])


def until(heard: Iterator[dict[str, Any]], true: Callable[[dict[str, Any]], bool]) -> Any:
    """Return the first of what is so that is as wanted; None when the flight ends before."""
    return next((now for now in heard if true(now)), None)


def tap_twice(port: int, token: str, order: dict[str, Any]) -> str:
    """Ask for something and say yes; return what was done. Raises KeyError when it is refused."""
    first = _act(port, token, order)
    time.sleep(BETWEEN_S)
    return _act(port, token, {"again": first["again"]})["done"]


def look_too(port: int, token: str, others: int, stack: ExitStack) -> None:
    """Have so many others look, the last of whom stands still once it hears; until the stack
    ends.
    """
    words = [sys.executable, "-m", __name__, str(port), token]
    for number in range(others):
        other = stack.enter_context(subprocess.Popen(words, stdout=subprocess.PIPE))
        stack.callback(other.kill)
        assert other.stdout is not None and other.stdout.readline() == b"hears\n"
        if number == others - 1:
            other.send_signal(signal.SIGSTOP)


def _act(port: int, token: str, order: dict[str, Any]) -> dict[str, Any]:
    line = HTTPConnection(HOST, port, timeout=30.0)
    line.request("POST", f"/act?token={token}", json.dumps({**order, "token": token}))
    return json.loads(line.getresponse().read())


if __name__ == "__main__":
    every = hears(int(sys.argv[1]), sys.argv[2])
    next(every)
    print("hears", flush=True)
    for _ in every:
        pass
