"""The far side of a serial port: made-up beacons behind a pseudo terminal, in real time, for an
unmodified pyserial.
"""

from __future__ import annotations

import asyncio
import math
import os
import tempfile
import threading
import tty
from collections import deque
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Self

import numpy as np

from drivers.beacons.log import TRUTH_FILE, write_truth
from drivers.beacons.marvelmind import Marvelmind, MarvelmindConfig
from drivers.interfaces import BeaconError
from drivers.mavlink.vision import VisionConfig
from drivers.rig.parts import NoOptions, PartContext, Rig
from drivers.rig.tables import RigError, decode_table
from hil.beacons.noise import BeaconConfig
from hil.beacons.system import BeaconFrame, BeaconSystem, ByteChunk, truth_of
from hil.camera.shared import RUN_VARIABLE
from hil.world.snapshot import Snapshot
from path.arrays import Array
from path.geometry.rotation import R_from_rpy
from path.messages import Role, Vec3

HEDGE_HZ = 16.0  # of each drone's own; PX4 wants more than 10
APPEARS_S = 180.0  # a world that is warmed up first; the harness gives it up before
POLL_S = 0.05


class SerialCable:
    """One end is a port with a name that stays (``link``), into the other goes what ``send`` is
    given.
    """

    def __init__(self, link: Path) -> None:
        self.link = link
        self._ends: tuple[int, int] | None = None

    def plug(self) -> None:
        """Raise OSError when there are no pseudo terminals left."""
        far, port = os.openpty()
        tty.setraw(port)
        os.set_blocking(far, False)
        self._ends = far, port
        self.link.unlink(missing_ok=True)
        self.link.symlink_to(os.ttyname(port))

    def send(self, data: bytes) -> None:
        """Send bytes from the port. As on a wire, what nobody reads in time is lost."""
        if self._ends is not None:
            with suppress(BlockingIOError):
                os.write(self._ends[0], data)

    def received(self) -> bytes:
        """Return what was written to the port."""
        with suppress(BlockingIOError):
            if self._ends is not None:
                return os.read(self._ends[0], 65536)
        return b""

    def unplug(self) -> None:
        """Close the port; a program that has it open reads its end."""
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
        cable_of: Callable[[str], SerialCable],
        now_s: Callable[[], float],
        place: Callable[[str], tuple[float, Array]],
    ) -> None:
        """
        Args:
            cable_of: where that goes which a beacon's turn brought, by its name.
            now_s: the world's time.
            place: by its name, where a beacon is now, (3,), and when that is: a busy computer comes
                late to a turn.
        """
        super().__init__(name="beacons", daemon=True)
        self._system = system
        self._cable_of = cable_of
        self._now_s = now_s
        self._place = place
        self._ending = threading.Event()

    def run(self) -> None:
        due: deque[tuple[ByteChunk, SerialCable]] = deque()
        for turn_s, name in self._system.turns(self._now_s()):
            while True:
                now_s = self._now_s()
                while due and due[0][0].arrives_s <= now_s:
                    chunk, cable = due.popleft()
                    cable.send(chunk.data)
                wait_s = min(turn_s, due[0][0].arrives_s if due else turn_s) - now_s
                if turn_s <= now_s:
                    break
                if self._ending.wait(wait_s):
                    return
            if turn_s > now_s - 0.05:  # what a stalled computer missed is left out
                due.append((self._system.hear(name, *self._place(name)), self._cable_of(name)))

    def end(self) -> None:
        self._ending.set()
        self.join()


@contextmanager
def open_beacons(
    rig: Rig,
    seed: int,
    out: Path,
    now_s: Callable[[], float],
    snapshot: Callable[[], Snapshot],
) -> Generator[None, None, None]:
    """Beacons behind this run's own serial port, when the rig's driver is the one that looks there;
    else nothing.

    Args:
        out: folder for what is true of them.
        now_s: the world's time; ``snapshot`` is the world at that time.
    """
    reference = rig.reference
    if (
        reference is None
        or reference.beacons is None
        or not reference.beacons.factory.startswith(f"{__name__}:")
    ):
        yield
        return
    config = BeaconConfig()
    system = BeaconSystem(
        config,
        seed,
        {name: own.address for name, own in reference.mounted.items()},
    )
    mounted = reference.mounted

    def place(name: str) -> tuple[float, Array]:
        world = snapshot()
        lever_m = np.array(mounted[name].lever_m)
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
    beacons = BeaconThread(system, lambda _: cable, now_s, place)
    beacons.start()
    try:
        yield
    finally:
        beacons.end()
        cable.unplug()


@contextmanager
def open_hedges(
    rig: Rig,
    seed: int,
    now_s: Callable[[], float],
    snapshot: Callable[[], Snapshot],
) -> Generator[None, None, None]:
    """A beacon on each drone whose autopilot is fed by one that this run makes up, each with a port
    of its own.

    Their frame is the one that the rig says it is. Raises RigError when the drones' tables differ
    in it.
    """
    tables = {role: table for role in Role if (table := _vision(rig, role)) is not None}
    if not tables:
        yield
        return
    frames = [(table.x_heading_deg, table.zero_n_m) for table in tables.values()]
    if len(set(frames)) > 1:
        raise RigError(
            [f"{rig.where('vehicle.vision')}: the drones' x_heading_deg and zero_n_m differ"]
        )
    system = BeaconSystem(
        replace(BeaconConfig(), rate_hz=HEDGE_HZ), seed, {role.value: table.address for role, table in tables.items()},
        surveyed=frame_of(*frames[0]),
    )  # fmt: skip
    cables = {role.value: SerialCable(link_of(os.environ[RUN_VARIABLE], role)) for role in tables}

    def place(name: str) -> tuple[float, Array]:
        world = snapshot()
        role = Role(name)
        return world.time_s, world.drones[role].T_w_b.apply(np.array(tables[role].lever_b_m))

    for cable in cables.values():
        cable.plug()
    beacons = BeaconThread(system, cables.__getitem__, now_s, place)
    beacons.start()
    try:
        yield
    finally:
        beacons.end()
        for cable in cables.values():
            cable.unplug()


def _vision(rig: Rig, role: Role) -> VisionConfig | None:
    """Return how the drone's autopilot is fed, when this run makes it up; else None."""
    table = rig.role(role).vehicle.options.get("vision")
    if table is None:
        return None
    vision = decode_table(table, VisionConfig, rig.where(f"{role.value}.vehicle.vision"))
    return vision if vision.beacons.factory.startswith(f"{__name__}:") else None


def frame_of(x_heading_deg: float, zero_n_m: Vec3) -> BeaconFrame:
    """The beacons' frame as a ``VisionConfig`` has it, from the world's (ENU)."""
    yaw_rad = math.radians(x_heading_deg - 90.0)
    north_m, east_m, down_m = zero_n_m
    return BeaconFrame(yaw_rad, -R_from_rpy(0.0, 0.0, yaw_rad) @ (east_m, north_m, -down_m))


def link_of(run: str, role: Role | None = None) -> Path:
    """The port's name in a run: a drone's own, or the listener's."""
    return (
        Path(tempfile.gettempdir())
        / f"path-{run}-{'beacons' if role is None else f'{role.value}-hedge'}"
    )


class PtyBeacons(Marvelmind):
    """The driver on the port that this run's world opens: it is waited for."""

    Config = NoOptions

    def __init__(self, config: NoOptions, context: PartContext) -> None:
        del config
        self._link = self._link_of(os.environ.get(RUN_VARIABLE) or f"run-{os.getpid()}", context)
        super().__init__(MarvelmindConfig(ports=(str(self._link),)), context)

    def _link_of(self, run: str, context: PartContext) -> Path:
        del context
        return link_of(run)

    async def __aenter__(self) -> Self:
        """Raise BeaconError when the world opens no port."""
        try:
            async with asyncio.timeout(APPEARS_S):
                while not self._link.exists():  # noqa: ASYNC110 (another process makes it)
                    await asyncio.sleep(POLL_S)
        except TimeoutError:
            raise BeaconError(
                f"no port {self._link} in {APPEARS_S:g} s", "did the world start? see its stderr"
            ) from None
        return await super().__aenter__()


class PtyHedge(PtyBeacons):
    """The driver on the port of the beacon that this drone carries in this run."""

    def _link_of(self, run: str, context: PartContext) -> Path:
        return link_of(run, context.role)
