"""The end of a mission that an error means."""

from __future__ import annotations

import sys
import traceback

from drivers.interfaces import CameraError, LinkError, StateError, TakenOver, VehicleError
from flight.outcome import MissionEnd, Outcome

_ENDS = (
    (CameraError, Outcome.CAMERA_LOST),
    (TakenOver, Outcome.PILOT_OVERRIDE),  # before what it is a kind of
    (VehicleError, Outcome.VEHICLE_REFUSED),
    (LinkError, Outcome.PEER_LOST),
    (StateError, Outcome.STATE_LOST),
)


def as_end(error: BaseException) -> MissionEnd:
    """Any error as the named end it means. Errors nobody foresaw are printed: they are bugs."""
    if isinstance(error, MissionEnd):
        return error
    for kind, outcome in _ENDS:
        if isinstance(error, kind):
            return MissionEnd(outcome, str(error))
    traceback.print_exception(error, file=sys.stderr)
    return MissionEnd(Outcome.CRASHED, f"{type(error).__name__}: {error}")
