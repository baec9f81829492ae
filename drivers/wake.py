"""Waking an event loop from another thread."""

from __future__ import annotations

import asyncio
from contextlib import suppress


def wake(loop: asyncio.AbstractEventLoop, event: asyncio.Event) -> None:
    """Set the event soon; nobody waits any more when the loop is closed."""
    with suppress(RuntimeError):
        loop.call_soon_threadsafe(event.set)
