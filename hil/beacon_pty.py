"""The far side of a serial port: made-up beacons behind a pseudo terminal, in real time, for an unmodified pyserial."""

from __future__ import annotations

import asyncio
import os
import tempfile
import threading
import tty
from collections import deque
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from drivers.beacon_log import TRUTH_FILE, write_truth
from drivers.interfaces import BeaconError
from drivers.marvelmind import Marvelmind, MarvelmindConfig
from drivers.rig import PartContext, Rig
from hil.beacons import BeaconConfig, BeaconSystem, Chunk, truth_of
from hil.shared_camera import RUN_VARIABLE
from hil.snapshot import Snapshot
from path.messages import Role
from path.rotation import R_from_rpy

Array = NDArray[np.float64]

APPEARS_S = 180.0  # a world that is warmed up first; the harness gives it up before
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
            with suppress(BlockingIOError):
                os.write(self._ends[0], data)

    def received(self) -> bytes:
        """What was written to the port."""
        with suppress(BlockingIOError):
            if self._ends is not None:
                return os.read(self._ends[0], 65536)
        return b""

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
        self,
        system: BeaconSystem,
        cable: SerialCable,
        now_s: Callable[[], float],
        place: Callable[[str], tuple[float, Array]],
    ) -> None:
        """
        Args:
            now_s: the world's time.
            place: by its name, where a beacon is now, (3,), and when that is: a busy computer comes late to a turn.
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
                due.append(self._system.hear(name, *self._place(name)))

    def end(self) -> None:
        self._ending.set()
        self.join()


@contextmanager
def open_beacons(
    rig: Rig, seed: int, out: Path, now_s: Callable[[], float], snapshot: Callable[[], Snapshot]
) -> Generator[None, None, None]:
    """Beacons behind this run's own serial port, when the rig's driver is the one that looks there; else nothing.

    Args:
        out: folder for what is true of them.
        now_s: the world's time; ``snapshot`` is the world at that time.
    """
    reference = rig.reference
    if reference is None or reference.beacons is None or not reference.beacons.factory.startswith(f"{__name__}:"):
        yield
        return
    config = BeaconConfig()
    system = BeaconSystem(config, seed, {name: own.address for name, own in reference.mounted.items()})
    mounted = reference.mounted

    def place(name: str) -> tuple[float, Array]:
        world, lever_m = snapshot(), np.array(mounted[name].lever_m)
        if name == "target":
            target = world.objects[0]
            place_w = np.array(target.position_w_m) + R_from_rpy(0.0, 0.0, target.yaw_rad) @ lever_m
        else:
            place_w = world.drones[Role(name)].T_w_b.apply(lever_m)
        return world.time_s, place_w

    # who listens does so by this computer's clock, as the roles do
    write_truth(out / TRUTH_FILE, replace(truth_of(system, config), offset_s=0.0))
    cable = SerialCable(link_of(os.environ[RUN_VARIABLE]))
    cable.plug()
    beacons = BeaconThread(system, cable, now_s, place)
    beacons.start()
    try:
        yield
    finally:
        beacons.end()
        cable.unplug()


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
