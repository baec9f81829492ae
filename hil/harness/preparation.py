"""Compile every kernel that a run will use, or load it compiled, before the run's clock starts."""

from __future__ import annotations

from collections.abc import Callable

from drivers.rig.parts import Rig
from drivers.rig.tables import decode_table
from flight.harness.flights import Progress
from hil.world.snapshot import Snapshot
from hil.world.world import World, WorldConfig
from path.marker.warm_up import warm_up as warm_up_marker
from path.messages import Role
from path.observations import Box

FIRST_START = "preparing: kernels are compiled at the first start, for about half a minute"


def starting(role: Role, what: str) -> Progress:
    """Returns what the console shows while there is no role yet."""
    return Progress(role, 0, "starting", 0, 0, None, None, None, 0.0, False, what)


def prepare(rig: Rig, say: Callable[[str], None]) -> None:
    """The physics, the marker finder, and what the perception of this rig computes."""
    say(FIRST_START)
    world = World(decode_table(rig.world, WorldConfig, rig.where("world")), seed=0)
    world.advance(0.1)
    warm_up_marker()
    if any("camera" in rig.role(role).perception.options for role in Role):
        from drivers.realsense.registration import warm_up as warm_up_registration  # noqa: PLC0415 (sim needs none of these)
        from hil.render.depth import warm_up as warm_up_depth  # noqa: PLC0415
        from hil.render.renderer import warm_up as warm_up_renderer  # noqa: PLC0415

        warm_up_renderer(lambda stage, number, of: say(f"preparing the renderer: {stage}, {number} of {of}"))
        warm_up_depth()
        warm_up_registration()
    else:
        _look_once(rig, world.snapshot())


def _look_once(rig: Rig, snapshot: Snapshot) -> None:
    """Ask a geometric view of each role everything that can be asked."""
    from hil.camera.capture import Capture  # noqa: PLC0415 (rendered levels need none of these)
    from hil.geometric.noise import ObservationNoise  # noqa: PLC0415
    from hil.geometric.perception import GeometricView, Sensor  # noqa: PLC0415
    from hil.geometric.scene import CameraSetup  # noqa: PLC0415

    for role in Role:
        own = rig.role(role)
        setup = CameraSetup(role, own.camera, own.mount.T_b_c, own.mount.T_b_v, rig.layout)
        view = GeometricView(Capture(0, 0, snapshot), Sensor(setup, ObservationNoise(), rig.method, 0))
        view.targets(None)
        view.markers(None)
        view.depth(Box(300.0, 220.0, 60.0, 40.0))
