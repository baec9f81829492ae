"""The far side of a serial port: made-up beacons behind a pseudo terminal, in real time, for an unmodified pyserial."""

from __future__ import annotations

import asyncio
import contextlib
import os
import tempfile
import threading
import tty
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from drivers.interfaces import BeaconError
from drivers.marvelmind import Marvelmind, MarvelmindConfig
from drivers.rig import PartContext
from hil.beacons import BeaconSystem, Chunk
from hil.shared_camera import RUN_VARIABLE

Array = NDArray[np.float64]

APPEARS_S = 60.0  # a world that is warmed up first
POLL_S = 0.05


class SerialCable:
    """One end is a port with a name that stays (``link``), into the other goes what ``send`` is given."""

    def __init__(self, link: Path) -> None:
        self.link = link
        self._ends: tuple[int, int] | None = None

    def plug(self) -> None:
        """Raises OSError when there are no pseudo terminals left."""
        far, port = os.openpty()
        tty.setraw(port)
        os.set_blocking(far, False)
        self._ends = far, port
        self.link.unlink(missing_ok=True)
        self.link.symlink_to(os.ttyname(port))

    def send(self, data: bytes) -> None:
        """What nobody reads in time is lost, as on a wire."""
        if self._ends is not None:
            with contextlib.suppress(BlockingIOError):
                os.write(self._ends[0], data)

    def unplug(self) -> None:
        """Who has the port open reads its end."""
        if self._ends is not None:
            self.link.unlink(missing_ok=True)
            for end in self._ends:
                os.close(end)
            self._ends = None


class BeaconThread(threading.Thread):
    """Lets the beacons take their turns in real time, and sends what comes of it when it is due."""

    def __init__(
        self, system: BeaconSystem, cable: SerialCable, now_s: Callable[[], float], place: Callable[[str], Array]
    ) -> None:
        """
        Args:
            now_s: the world's time.
            place: where a beacon is now, (3,), by its name.
        """
        super().__init__(name="beacons", daemon=True)
        self._system, self._cable, self._now_s, self._place = system, cable, now_s, place
        self._ending = threading.Event()

    def run(self) -> None:
        due: deque[Chunk] = deque()
        for turn_s, name in self._system.turns(self._now_s()):
            while True:
                now_s = self._now_s()
                while due and due[0].arrives_s <= now_s:
                    self._cable.send(due.popleft().data)
                wait_s = min(turn_s, due[0].arrives_s if due else turn_s) - now_s
                if turn_s <= now_s:
                    break
                if self._ending.wait(wait_s):
                    return
            if turn_s > now_s - 0.05:  # what a stalled computer missed is left out
                due.append(self._system.hear(name, turn_s, self._place(name)))

    def end(self) -> None:
        self._ending.set()
        self.join()


def link_of(run: str) -> Path:
    """The port's name in a run."""
    return Path(tempfile.gettempdir()) / f"path-{run}-beacons"


@dataclass(frozen=True, slots=True)
class PtyBeaconsConfig:
    """Nothing to set: the port is the run's own."""


class PtyBeacons(Marvelmind):
    """The driver on the port that this run's world opens: it is waited for."""

    Config = PtyBeaconsConfig

    def __init__(self, config: PtyBeaconsConfig, context: PartContext) -> None:
        del config
        self._link = link_of(os.environ.get(RUN_VARIABLE) or f"run-{os.getpid()}")
        super().__init__(MarvelmindConfig(ports=(str(self._link),)), context)

    async def __aenter__(self) -> Self:
        """Raises BeaconError when the world opens no port."""
        try:
            async with asyncio.timeout(APPEARS_S):
                while not self._link.exists():  # noqa: ASYNC110 (another process makes it)
                    await asyncio.sleep(POLL_S)
        except TimeoutError:
            raise BeaconError(
                f"no port {self._link} in {APPEARS_S:g} s", "did the world start? see its stderr"
            ) from None
        return await super().__aenter__()
