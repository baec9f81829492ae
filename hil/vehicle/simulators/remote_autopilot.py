"""The harness's knowledge of a real autopilot, from the packets on its cable and from its
simulator.
"""

from __future__ import annotations

from drivers.interfaces import FlightMode
from hil.autopilot.values import AutopilotConfig, OffboardSession
from hil.vehicle.simulators.link import SimulatorLink
from hil.vehicle.simulators.radio import SimulatedRadio
from hil.vehicle.simulators.relay import MavlinkRelay

OF_FAILSAFES = (FlightMode.HOLD, FlightMode.LAND, FlightMode.RETURN)


class RemoteAutopilot:
    """Answers for a real autopilot what the harness asks of an embedded one
    (``hil.autopilot.autopilot.Autopilot``).

    Without a relay in the cable, as with a flight controller, nobody hears the setpoints: no
    session is ever shown.
    """

    config = AutopilotConfig()  # of which the monitors ask at what battery it may land by itself

    def __init__(
        self,
        relay: MavlinkRelay | None,
        link: SimulatorLink,
        radio: SimulatedRadio | None = None,
    ) -> None:
        """``radio``: the pilot's, None where there is none."""
        self._link = link
        self._radio = radio
        self._cable = link if relay is None else relay
        self._taken = False

    @property
    def armed(self) -> bool:
        return self._cable.watch.armed

    @property
    def powered(self) -> bool:
        return self.armed and not self.killed

    @property
    def radio(self) -> SimulatedRadio:
        """The pilot's. A fault of a radio that is not there is refused before the flight."""
        assert self._radio is not None
        return self._radio

    @property
    def killed(self) -> bool:
        """Return whether its pilot's kill switch is thrown: the motors stand still."""
        return self._radio is not None and self._radio.transmitter.kill

    @property
    def failsafe(self) -> str:
        """Its modes say no more than that they changed: with the radio gone, which script would fly
        them is known.
        """
        return (
            "radio lost"
            if self._radio is not None and self._radio.lost and self.mode in OF_FAILSAFES
            else ""
        )

    @property
    def mode(self) -> FlightMode:
        return self._cable.watch.mode

    @property
    def pilot_in_control(self) -> bool:
        """Return whether somebody else selects its mode.

        The harness does, as a second ground station, or it flies in a mode that no script selects.
        """
        return self.armed and (self._taken or self.mode is FlightMode.OTHER)

    @property
    def pilots_mode(self) -> FlightMode | None:
        """Nobody is told which mode a pilot selected, only which one it is in."""
        return None

    @property
    def battery(self) -> float:
        return self._link.battery

    @property
    def newest_setpoint_s(self) -> float:
        return self._cable.watch.newest_setpoint_s

    @property
    def offboard_sessions(self) -> list[OffboardSession]:
        return self._cable.watch.offboard_sessions

    @property
    def setpoint_gap_s(self) -> float:
        return self._cable.watch.setpoint_gap_s

    def request_mode(
        self,
        now_s: float,
        mode: FlightMode,
        by_pilot: bool = False,
    ) -> None:
        """Change the mode as a pilot; nobody else's change can be asked for."""
        del now_s, mode
        assert by_pilot
        self._taken = True
        self._cable.pilot_takes_over()

    def kill(self, _now_s: float) -> None:
        """Throws the kill switch of its pilot's radio."""
        self.radio.transmitter.kill = True

    def set_battery(self, fraction: float) -> None:
        """Let the simulated battery sag."""
        self._link.sag_battery(fraction)
