"""The control loop of one drone: one setpoint per tick, from whatever guidance is in force,
guarded.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from drivers.interfaces import Clock, FlightMode, Log, Vehicle, VehicleState, VelocitySetpoint
from drivers.steady_clock import SteadyClock
from flight.config import MissionConfig
from flight.guard.limits import check_vehicle, in_doubt
from flight.guard.under_guard import UnderGuard
from flight.guidance import Anchor, slew
from flight.outcome import MissionEnd, Outcome
from path.geometry.rotation import yaw_of

# With a tick before it and one after it setpoints are not 0.2 s apart (S8): two messages at 10 Hz.
DOUBT_S = 0.1
Guidance = Callable[[VehicleState], VelocitySetpoint]


class Pilot:
    """Flies a vehicle in offboard control. ``guidance`` may be exchanged at any time; it must not
    block.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        clock: Clock,
        config: MissionConfig,
        log: Log,
        guard: UnderGuard | None = None,
    ) -> None:
        self._vehicle = vehicle
        self._guard = guard
        self._clock = SteadyClock.of(clock)
        self._config = config
        self.fence = config.fence
        self._log = log
        self._last = VelocitySetpoint((0.0, 0.0, 0.0), 0.0)
        self.guidance: Guidance = self._stay
        self.in_control = False
        self.setpoints = 0  # sent since the beginning
        self._doubt_ns: int | None = None  # since when one message says that somebody else took it
        # how often one message said that somebody else took it, and the next that nobody did
        self.taken_back = 0
        self.override = ""  # how somebody else took the vehicle: nothing may be commanded any more

    def _stay(self, state: VehicleState) -> VelocitySetpoint:
        return VelocitySetpoint((0.0, 0.0, 0.0), yaw_of(state.q_n_b))

    def hold_here(self) -> None:
        """Make staying at the present place the guidance."""
        state = self._vehicle.state
        anchor = Anchor(state.position_n_m, yaw_of(state.q_n_b))
        self.guidance = anchor.hold

    async def take_control(self) -> None:
        """Enter offboard control at a standstill; ``run`` must be started right after."""
        self.hold_here()
        self._last = VelocitySetpoint((0.0, 0.0, 0.0), yaw_of(self._vehicle.state.q_n_b))
        await self._vehicle.start_offboard(self._last)
        self.in_control = True

    async def run(self) -> None:
        """Send setpoints until cancelled or let go. Raises MissionEnd when the guard trips."""
        try:
            await self._run()
        except MissionEnd as end:
            if end.outcome is Outcome.PILOT_OVERRIDE:
                self.override = end.detail
            raise
        finally:
            self.in_control = False

    async def _run(self) -> None:
        period_s = 1.0 / self._config.control_hz
        loop = asyncio.get_running_loop()
        set_by_ns = self._clock.set_by_ns
        due_s = loop.time()
        while self.in_control:
            now_ns = self._clock.now_ns()
            self._check_clock(set_by_ns)
            state = self._vehicle.state
            if self._guard is not None:
                # first: that the guard changed the mode says more than that it was changed
                self._guard.check_hand()
            if self._doubts(state, now_ns):
                await asyncio.sleep(period_s)
                continue
            check_vehicle(state, now_ns, self._config.guard, FlightMode.OFFBOARD)
            self._last = self._before_walls(
                slew(self._last, self.guidance(state), period_s, self._config.max_accel_mps2), state
            )
            self._vehicle.fly(self._last)
            self.setpoints += 1
            self._log.write(
                "/setpoint",
                now_ns,
                {"velocity_n_mps": self._last.velocity_n_mps, "yaw_rad": self._last.yaw_rad},
            )
            # Late ticks are not made up for: after a stall one comes at once, and then again one
            # each period.
            due_s = max(due_s + period_s, loop.time())
            await asyncio.sleep(due_s - loop.time())

    def _check_clock(self, before_ns: int) -> None:
        """Raise MissionEnd(CLOCK_FAULT) when this drone's clock was set since it was set by so
        much.
        """
        step_ns = self._clock.set_by_ns - before_ns
        if step_ns:
            raise MissionEnd(
                Outcome.CLOCK_FAULT, f"this drone's own clock was set by {step_ns * 1e-9:+.3g} s"
            )

    def _doubts(self, state: VehicleState, now_ns: int) -> bool:
        """Returns whether a takeover is still to be confirmed or taken back.

        What nothing takes back in time has happened.
        """
        if not in_doubt(state, FlightMode.OFFBOARD):
            ours = state.armed and state.mode is FlightMode.OFFBOARD
            self.taken_back += ours and self._doubt_ns is not None
            self._doubt_ns = None
            return False
        if self._doubt_ns is None:
            self._doubt_ns = now_ns
            self._log.write("/doubt", now_ns, {"mode": state.mode.value, "armed": state.armed})
        return (now_ns - self._doubt_ns) * 1e-9 < DOUBT_S

    def _before_walls(self, setpoint: VelocitySetpoint, state: VehicleState) -> VelocitySetpoint:
        """Return a setpoint from which the drone can stop before it comes to an edge of the
        site.
        """
        config = self._config
        velocity = self.fence.stoppable(
            setpoint.velocity_n_mps,
            state.position_n_m,
            0.5 * config.max_accel_mps2,
            config.follow.response_s,
        )
        return VelocitySetpoint(velocity, setpoint.yaw_rad)

    def let_go(self) -> None:
        """Stop sending setpoints; the caller has commanded, or is about to command, another
        mode.
        """
        self.in_control = False
