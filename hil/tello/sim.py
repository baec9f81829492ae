"""A Tello's limits in virtual time: its state packets and its video, without djitellopy and sockets
between.

State packets are made as the emulated drone makes them, parsed and reckoned from as the driver
does; frames go through the emulated drone's encoder and a decoder. What is left out is the wire:
commands reach the simulated autopilot.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Annotated, Any, cast

import av
import numpy as np
from djitellopy import Tello  # type: ignore[import-untyped]

from drivers.interfaces import Capability, Frame, VehicleError, VehicleState
from drivers.rig.parts import PartContext
from drivers.tello.camera import TelloCamera
from drivers.tello.state import DeadReckoning, Placement, TelloReport, quaternion, read_report
from drivers.tello.vehicle import TelloVehicle
from hil.camera.rendered import RenderedCamera, RenderedCameraConfig
from hil.tello.emulator import STATE_PERIOD_S
from hil.tello.sensors import TelloSensors
from hil.tello.video import new_encoder
from hil.vehicle.sim_vehicle import SimVehicle, SimVehicleConfig
from hil.world.world import VehicleTelemetry
from path.bounds import Bounds
from path.values import frozen

BIT_RATE = 4_000_000


@frozen
class SimTelloConfig(SimVehicleConfig):
    """Besides a simulated vehicle's options those of ``drivers.tello.config`` about where it was
    put down.
    """

    north_m: Annotated[float, Bounds(-1000.0, 1000.0)] = 0.0
    east_m: Annotated[float, Bounds(-1000.0, 1000.0)] = 0.0
    heading_deg: Annotated[float, Bounds(-360.0, 360.0)] = 0.0
    placement_sigma_m: Annotated[float, Bounds(0.0, 5.0)] = 0.05
    velocity_sigma_mps: Annotated[float, Bounds(0.0, 5.0)] = 0.03


class SimTello(SimVehicle):
    """The Vehicle Protocol; knows of itself what a Tello's state packets say, ten times a
    second.
    """

    Config = SimTelloConfig
    lacks = TelloVehicle.lacks

    def __init__(self, config: SimTelloConfig, context: PartContext) -> None:
        super().__init__(config, context)
        placement = Placement(
            config.north_m,
            config.east_m,
            math.radians(config.heading_deg),
            config.placement_sigma_m,
            config.velocity_sigma_mps,
        )
        self._reckoning = DeadReckoning(placement, "start")
        self._sensors: TelloSensors | None = None
        self._report: TelloReport | None = None
        self._packets = -1

    def _take(self, telemetry: VehicleTelemetry, arrival_ns: int) -> None:
        super()._take_heartbeat(telemetry, arrival_ns)
        packets = math.floor(telemetry.time_s / STATE_PERIOD_S + 1e-6)
        if packets == self._packets:
            return
        self._packets = packets
        drone = self._harness.world.drone(self._role)
        if self._sensors is None:
            self._sensors = TelloSensors(drone, 0.0)
            self._sensors.ground_d_m = telemetry.estimate.position_n_m[2]
        report = read_report(Tello.parse_state(self._sensors.state_text()), arrival_ns)
        assert report is not None
        self._reckoning.add(report)
        self._newest = telemetry
        self._newest_ns = arrival_ns
        self._history.add(arrival_ns, self._attitude(report))
        self._report = report

    def _attitude(self, report: TelloReport) -> tuple[float, float, float, float]:
        return quaternion(report.roll_rad, report.pitch_rad, self._reckoning.heading_rad)

    def _combined(self) -> VehicleState:
        state = super()._combined()
        report = self._report
        if report is None:
            raise VehicleError("the vehicle is not connected", "enter it with `async with` first")
        return dataclasses.replace(
            state,
            position_n_m=self._reckoning.position_n_m,
            velocity_n_mps=self._reckoning.velocity_n_mps,
            q_n_b=self._attitude(report),
            position_sigma_m=self._reckoning.position_sigma_m,
        )


class SimTelloCamera(RenderedCamera):
    """Rendered frames through H.264, without depth. Each frame that is read is one of the
    stream.
    """

    Config = RenderedCameraConfig
    lacks: frozenset[Capability] = TelloCamera.lacks

    def __init__(self, config: RenderedCameraConfig, context: PartContext) -> None:
        super().__init__(config, context)
        size = context.camera.width, context.camera.height
        self._encoder = new_encoder(*size, max(1, round(config.rate_hz)), BIT_RATE)
        self._decoder: Any = av.CodecContext.create("h264", "r")
        self._decoder.thread_count = 1
        self._encoded = 0

    async def read(self, timeout_s: float) -> Frame:
        """Return the next frame as ``RenderedCamera.read``, through the drone's video codec."""
        frame = await super().read(timeout_s)
        image = cast(Any, av.VideoFrame.from_ndarray(frame.color, format="bgr24")).reformat(
            format="yuv420p"
        )
        image.pts = self._encoded
        self._encoded += 1
        shown = [
            each for packet in self._encoder.encode(image) for each in self._decoder.decode(packet)
        ]
        color = np.asarray(shown[-1].to_ndarray(format="bgr24"), np.uint8)
        return Frame(frame.stamp_ns, frame.frame_id, color, None)
