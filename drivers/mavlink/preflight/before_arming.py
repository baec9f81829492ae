"""The checks before a vehicle is armed, besides its own: its pilot's radio, and its own fence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from drivers.interfaces import VehicleError
from drivers.mavlink.preflight.geofence import FencePlan, Geofence, plan_fence
from drivers.mavlink.preflight.geofence import names_of as fence_names
from drivers.mavlink.preflight.parameters import Difference, ParameterAccess
from drivers.mavlink.preflight.pilot_rules import kept_out
from drivers.mavlink.preflight.pilot_rules import names_of as pilot_names
from drivers.mavlink.session import MavsdkSession
from drivers.mavlink.telemetry import TelemetrySlots
from drivers.mavlink.vehicle_config import MavsdkVehicleConfig
from drivers.rig.part_check import Finding


def access_of(session: MavsdkSession, url: str) -> ParameterAccess:
    """The parameters of an open session. Raises VehicleError."""
    access = session.parameters
    if access is None:
        raise VehicleError(f"{url} is not open", "enter the vehicle with `async with` first")
    return access


class BeforeArming:
    """The pilot and the fence of one vehicle that is open."""

    def __init__(
        self,
        session: MavsdkSession,
        telemetry: TelemetrySlots,
        config: MavsdkVehicleConfig,
    ) -> None:
        self._session = session
        self._telemetry = telemetry
        self._config = config

    @property
    def _access(self) -> ParameterAccess:
        return access_of(self._session, self._config.url)

    async def pilot_findings(self) -> Sequence[Finding]:
        """Check that a pilot's radio can take the vehicle; nothing is set. Raises VehicleError."""
        if self._config.rc == "none":
            said = 'NO REMOTE CONTROL (rc = "none"): no pilot can take this vehicle, nor stop its motors'
            return [
                Finding(
                    "note",
                    "pilot",
                    said,
                    "give it a radio, and leave rc out, before people are near it",
                )
            ]
        wrong = await self._without_pilot()
        fix = "switch the transmitter on; what each parameter means for the pilot: docs/field.md"
        if wrong:
            return [Finding("fault", "pilot", each, fix) for each in wrong]
        return [Finding("ok", "pilot", "a radio is heard, and can take the vehicle")]

    async def _without_pilot(self) -> list[str]:
        telemetry = self._telemetry
        heard = await self._session.until(
            lambda: bool(telemetry.radio_heard), self._config.mode_timeout_s
        )
        missing = [] if heard else ["no radio is heard, and the rig says that a pilot has one"]
        return missing + kept_out(
            self._telemetry.known_kind,
            await self._access.read(pilot_names(self._telemetry.known_kind)),
        )

    async def plan_geofence(self, fence: Geofence) -> FencePlan:
        """Return what has to be done about the autopilot's own fence; nothing is set. Raises
        VehicleError.
        """
        telemetry = self._telemetry
        if not await self._session.until(
            lambda: telemetry.position is not None, self._config.connect_timeout_s
        ):
            raise VehicleError(
                "its fence is around its home, and it does not say where it is",
                "give it a clear sky",
            )
        position = telemetry.position
        assert position is not None
        found = await self._access.read(fence_names(self._telemetry.known_kind))
        return plan_fence(self._telemetry.known_kind, found, fence, position.n_m)

    async def keep_geofence(self, fence: Geofence) -> Mapping[str, float]:
        """Give the autopilot a fence of its own, one step wider than the script's, and read it
        back.

        What was set, by name. Raises VehicleError where that is not possible: then nothing is to be
        armed.
        """
        remedy = "look at `path-handoff doctor --rig RIG --role ROLE`; docs/field.md says what the fence is for"
        plan = await self.plan_geofence(fence)
        if plan.problems:
            raise VehicleError(f"vehicle {self._config.sysid}: {'; '.join(plan.problems)}", remedy)
        if plan.set_to and self._telemetry.state().armed:
            raise VehicleError(
                f"vehicle {self._config.sysid} is armed, and its fence is not set",
                "disarm it first",
            )
        for name, value in plan.set_to.items():
            await self._access.write(Difference(name, value, None))
        again = await self.plan_geofence(fence)
        if again.set_to or again.problems:
            raise VehicleError(
                f"vehicle {self._config.sysid} did not keep the fence it was given", remedy
            )
        return plan.set_to

    async def check_pilot(self) -> None:
        wrong = [] if self._config.rc == "none" else await self._without_pilot()
        if wrong:
            raise VehicleError(
                f"vehicle {self._config.sysid} cannot be taken by its pilot: {'; '.join(wrong)}",
                'switch the transmitter on and set what is named, or write rc = "none" in its table: then nobody can',
            )
