"""Something that is done again and again beside a test, by a thread of its own."""

from __future__ import annotations

import threading
from collections.abc import Callable, Generator
from contextlib import contextmanager


@contextmanager
def repeating(act: Callable[[], object], every_s: float) -> Generator[None]:
    """Until the block ends, which waits for the last time to be over."""
    ending = threading.Event()

    def run() -> None:
        while not ending.wait(every_s):
            act()

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        ending.set()
        thread.join()
