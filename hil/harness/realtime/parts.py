"""The parts of every world in real time: cameras that draw it, vehicles on the wire, and the pace
of its steps.
"""

from __future__ import annotations

import asyncio
import json
import os
import threading
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import Any
from urllib.parse import urlsplit

from drivers.link.udp import address_of
from drivers.mavlink.geodesy import LocalTangent
from drivers.realsense.camera import RealSenseConfig
from drivers.rig.parts import PartSpec, Rig, RoleRig, decode_part
from drivers.rig.tables import RigError
from hil.camera.d415 import T_COLOR_DEPTH, depth_camera
from hil.camera.shared import SharedCameraWriter
from hil.link.faulty import ProxySide
from hil.render.depth import DepthRenderer
from hil.render.renderer import Renderer
from hil.render.shutter import shutter_of
from hil.tello.video import TelloVideo
from hil.vehicle.mavlink_vehicle import MavlinkVehicle, MavlinkVehicleConfig
from hil.world.config import imaging_of
from hil.world.errors import Built, StampErrors
from hil.world.snapshot import Snapshot
from hil.world.world import SimDrone
from path.messages import Role

STEP_S = 0.005

FrameWriter = SharedCameraWriter | TelloVideo


Look = Callable[[], tuple[int, Snapshot] | None]
"""Gives the truth now, and the stamp of a frame that is taken of it; None while a camera is
frozen.
"""


class CameraView:
    """Draws what one drone's camera truly sees. Made before the world's clock starts: it takes a
    moment.
    """

    def __init__(
        self,
        built: Built,
        role: Role,
        seed: int,
        *,
        depth: bool,
    ) -> None:
        rig = built.rig
        own = rig.role(role)
        self.errors = built.sensors[role]
        self.role = role
        mount = own.mount
        imaging = imaging_of(rig)
        self._renderer = Renderer(
            own.camera, mount.T_b_c, mount.T_b_v, rig.layout, seed=seed, imaging=imaging,
            shutter=shutter_of(self.errors),
        )  # fmt: skip
        self._depth: DepthRenderer | None = None
        if depth:
            self._depth = DepthRenderer(
                self._renderer,
                depth_camera(*depth_size(rig, role)),
                T_COLOR_DEPTH,
            )

    def take(
        self,
        stamp_ns: int,
        snapshot: Snapshot,
        frame: int,
        writer: FrameWriter,
    ) -> None:
        color = self._renderer.render_color(snapshot, self.role, frame)
        if isinstance(writer, TelloVideo):
            writer.write(stamp_ns, color)
        elif self._depth is not None:
            late_s = self.errors.depth_late_s
            then = snapshot.carried_on(late_s) if late_s else snapshot
            writer.write(
                stamp_ns,
                color,
                self.errors.measured_mm(self._depth.render(then, self.role, frame)),
            )


class CameraThread(threading.Thread):
    """Takes one camera's frames at its rate and publishes them. A late frame is left out, and
    counted.

    Args:
        now_s: the world's clock. ``look``: at what is before the camera.
        phase: of a period; two cameras are never in step.
    """

    def __init__(
        self,
        now_s: Callable[[], float],
        look: Look,
        picture: CameraView,
        writer: FrameWriter,
        rate_hz: float,
        phase: float,
    ) -> None:
        super().__init__(name=f"camera-{picture.role.value}", daemon=True)
        self._now_s = now_s
        self._look = look
        self._picture = picture
        self._writer = writer
        self._period_s = 1.0 / rate_hz
        self._phase_s = phase * self._period_s
        self.ending = threading.Event()
        self.rendered = 0
        self.left_out = 0

    def run(self) -> None:
        period_s = self._period_s
        stamps = StampErrors(self._picture.errors, 1.0 / period_s)
        frame = max(0, int((self._now_s() - self._phase_s) / period_s))
        while not self.ending.is_set():
            due_s = self._phase_s + frame * period_s
            wait_s = due_s - self._now_s()
            if wait_s > 0.0:
                time.sleep(wait_s)
            elif wait_s < -period_s:
                skipped = int(-wait_s / period_s)
                self.left_out += skipped
                frame += skipped
                continue
            seen = self._look()
            if seen is not None:
                stamp_ns, snapshot = seen
                self._picture.take(stamp_ns + stamps.next_ns(), snapshot, frame, self._writer)
                self.rendered += 1
            frame += 1


@contextmanager
def running(camera: CameraThread) -> Generator[None, None, None]:
    camera.start()
    try:
        yield
    finally:
        camera.ending.set()
        camera.join()


def camera_config(rig: Rig, role: Role) -> RealSenseConfig:
    """Return the settings of a role's camera driver. Raises RigError when it is another driver."""
    perception = rig.role(role).perception
    camera = PartSpec.from_table(
        perception.options.get("camera"),
        f"{perception.where}.camera",
        perception.base,
    )
    _, config = decode_part(camera)
    if not isinstance(config, RealSenseConfig):
        raise RigError(
            [
                f"{camera.where}.factory: the world of level sitl draws for drivers.realsense.camera:RealSense only"
            ]
        )
    return config


def depth_size(rig: Rig, role: Role) -> tuple[int, int]:
    """Width and height that the driver asks the depth camera for."""
    color = rig.role(role).camera
    return camera_config(rig, role).depth_size or (color.width, color.height)


def shared_camera(
    run: str,
    rig: Rig,
    role: Role,
) -> SharedCameraWriter:
    """Return the writer of frames to where a role's driver looks for them."""
    color = rig.role(role).camera
    size = (color.width, color.height)
    fps = camera_config(rig, role).fps
    return SharedCameraWriter(run, role, size, depth_size(rig, role), fps)


GROUND = "PATH_GCS"
"""The variable of the environment that names where a ground station listens: ``path-handoff handoff
--gcs``.
"""


def embedded_vehicle(
    rig: Rig,
    own: RoleRig,
    drone: SimDrone,
    arrived: Callable[[float], float],
) -> MavlinkVehicle:
    """A drone's autopilot on the wire, where the role's driver listens, its guard's, and a ground
    station if any.

    ``arrived``: the world's time of an instant of the monotonic clock.
    """
    ground = _listener(f"udp://{os.environ[GROUND]}") if os.environ.get(GROUND) else None
    second = None if own.guard is None else _listener(str(own.guard.options["url"]))
    tangent = LocalTangent.at(rig.origin)
    options = own.vehicle.options
    config = MavlinkVehicleConfig(
        int(options["sysid"]),
        _listener(str(options["url"])),
        second=second,
        ground=ground,
    )
    return MavlinkVehicle(config, drone, tangent, arrived)


def _listener(url: str) -> tuple[str, int]:
    """Return the host and port at which a MAVLink URL listens."""
    parts = urlsplit(url)
    return parts.hostname or "127.0.0.1", parts.port or 0


def proxy_side(own: RoleRig) -> ProxySide:
    """The fault proxy listens where a drone's link believes the other one to be."""
    end = own.link.options
    return ProxySide(address_of(end["peer"], "peer"), address_of(end["bind"], "bind"))


async def at_pace(now_s: Callable[[], float], step: Callable[[int], bool]) -> None:
    """Call ``step`` with its number at 200 Hz until it says that it is over.

    What was missed is stepped at once, not caught up tick by tick.
    """
    steps = 0
    while not step(steps):
        steps += 1
        await asyncio.sleep(max(0.0, steps * STEP_S - now_s()))
        if now_s() > (steps + 2) * STEP_S:
            steps = int(now_s() / STEP_S)


def say(event: dict[str, Any]) -> None:
    """One event to the parent process."""
    print(json.dumps(event), flush=True)
