"""A real autopilot's simulator, as a rig names it."""

from __future__ import annotations

from dataclasses import field
from typing import Annotated, Literal

from path.bounds import AutopilotValues, Bounds, check_bounds
from path.values import frozen

Kind = Literal["px4", "ardupilot"]


@frozen
class SimulatorConfig:
    """``[world.sender_simulator]`` and ``[world.receiver_simulator]``: the drone is flown by a real
    autopilot.

    Attributes:
        kind: which one.
        url: ``udp://HOST:PORT`` that one already running sends its companion link to; empty starts
            one.
        truth_url: the same for the link it tells the truth on. A serial port,
            ``serial:///dev/ttyACM1:921600``, is that of a flight controller that simulates on
            board: nothing is started, and ``url`` stays empty.
        ready_s: bound on its start, until it can be armed and knows where it is.
        speedup: of the simulation until it is ready, then 1. ArduPilot's estimator takes 40 s of
            its own time.
        parameters: of the simulation alone; what flying needs stands with the vehicle.
    """

    kind: Kind
    url: str = ""
    truth_url: str = ""
    ready_s: Annotated[float, Bounds(1.0, 1800.0)] = 120.0
    speedup: Annotated[float, Bounds(1.0, 20.0, "times")] = 1.0
    parameters: AutopilotValues = field(default_factory=dict[str, float])

    def __post_init__(self) -> None:
        if self.on_board and self.url:
            raise ValueError(
                "a flight controller's companion link is the vehicle's url: leave this one out"
            )
        if not self.on_board and bool(self.url) != bool(self.truth_url):
            raise ValueError("a simulator that runs already needs both url and truth_url")
        check_bounds(self)
        if self.kind == "px4" and self.speedup != 1.0:
            raise ValueError("PX4's speed cannot be changed while it runs: leave speedup out")
        if self.on_board and (self.speedup != 1.0 or self.parameters):
            raise ValueError(
                "a flight controller keeps its own time and parameters: leave both out"
            )

    @property
    def on_board(self) -> bool:
        """Return whether it is a flight controller on the bench."""
        return self.truth_url.startswith("serial://")

    @property
    def to_start(self) -> bool:
        return not (self.url or self.on_board)
