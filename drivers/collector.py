"""The collector of cyclic garbage, off while much is made that stays."""

from __future__ import annotations

import gc
from collections.abc import Generator
from contextlib import contextmanager


@contextmanager
def collector_off() -> Generator[None]:
    """While modules are imported, logs are read, or time is virtual: all that was made would be
    walked for nothing.

    Not while something flies in real time: what lives in cycles stays until it is on again.
    """
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()
