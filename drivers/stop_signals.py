"""Requests from outside to end a flight: the drone lands, and then the program ends."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
import threading
from collections.abc import Callable


def stop_signals() -> tuple[signal.Signals, ...]:
    """Ctrl-C, a request to end, and a terminal that went away, unless the program was started to
    outlive it (nohup).
    """
    outlives = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    return (
        (signal.SIGINT, signal.SIGTERM)
        if outlives
        else (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    )


def stop_on_signals(stop: Callable[[], None]) -> None:
    """Have the running loop call ``stop`` for each of them. Off the main thread the signals are
    somebody else's.
    """
    if threading.current_thread() is threading.main_thread():
        loop = asyncio.get_running_loop()
        for number in stop_signals():
            loop.add_signal_handler(number, stop)


def leave_signals() -> None:
    """Take back what ``stop_on_signals`` did to the running loop."""
    loop = asyncio.get_running_loop()
    for number in stop_signals():
        loop.remove_signal_handler(number)


def stop_at_end_of_input(stop: Callable[[], None]) -> None:
    """Have the running loop call ``stop`` once stdin is closed: the parent of this program is
    gone.
    """
    loop = asyncio.get_running_loop()
    standard_input = sys.stdin.fileno()

    def read() -> None:
        if not os.read(standard_input, 4096):
            loop.remove_reader(standard_input)
            stop()

    loop.add_reader(standard_input, read)
