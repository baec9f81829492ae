"""The parameters that decide whether a pilot with a radio can take a vehicle, and the values that
would keep one out.

The meaning of each value is that of PX4 1.17.0's and ArduCopter 4.7-dev's own parameter
descriptions and sources.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from drivers.mavlink.modes import PX4, AutopilotKind
from path.values import frozen

RADIO_FIRST = frozenset({0, 5, 7})
ESTOP = 31  # of RCn_OPTION: Motor Emergency Stop
SWITCH_CHANNELS = range(5, 17)


@frozen
class PilotRule:
    """A parameter by name, whether a value of it leaves the pilot in command, and what goes wrong
    with one that does not."""

    name: str
    leaves: Callable[[float], bool]
    otherwise: str


def _bit(number: int) -> Callable[[float], bool]:
    return lambda value: not round(value) >> number & 1


SILENCING = (
    PilotRule(
        "COM_RC_IN_MODE",
        lambda value: round(value) in RADIO_FIRST,
        "1 and 4 ignore every radio, so that mode switch and kill switch do nothing; with 2, 3, 6 and 8 a ground "
        "station's joystick can keep it out: 0 is the radio alone, 5 and 7 put it first",
    ),
    PilotRule(
        "RC_OPTIONS",
        _bit(0),
        "bit 0 ignores the receiver: mode switch and kill switch do nothing",
    ),
    PilotRule(
        "FENCE_OPTIONS",
        _bit(0),
        "bit 0 refuses the pilot's mode switch after a breach of the fence",
    ),
)
"""Values that no rig may ask for, and no vehicle have, wherever there is a pilot or should be
one.
"""

_WITH_RADIO: Mapping[str, tuple[PilotRule, ...]] = {
    "px4": (
        PilotRule("RC_MAP_FLTMODE", lambda value: value > 0.0, "no channel is the mode switch"),
        PilotRule("RC_MAP_KILL_SW", lambda value: value > 0.0, "no channel is the kill switch"),
    ),
    "ardupilot": (
        PilotRule("FLTMODE_CH", lambda value: value > 0.0, "no channel is the mode switch"),
        PilotRule("FS_THR_ENABLE", lambda value: value > 0.0, "a lost radio would not be noticed"),
    ),
}
_ESSENTIAL = frozenset(
    {"COM_RC_IN_MODE", "RC_MAP_FLTMODE", "RC_MAP_KILL_SW", "FLTMODE_CH", "FS_THR_ENABLE"}
)


def names_of(kind: AutopilotKind) -> tuple[str, ...]:
    """The parameters to read of a vehicle of this kind."""
    own = ("COM_RC_IN_MODE",) if kind is PX4 else ("RC_OPTIONS", "FENCE_OPTIONS")
    options = () if kind is PX4 else tuple(f"RC{channel}_OPTION" for channel in SWITCH_CHANNELS)
    return (*own, *(rule.name for rule in _WITH_RADIO[kind.name]), *options)


def kept_out(kind: AutopilotKind, found: Mapping[str, float | None]) -> list[str]:
    """The reasons for which a pilot with a radio could not take a vehicle with these parameters;
    empty when one can.
    """
    wrong: list[str] = []
    for rule in (*SILENCING, *_WITH_RADIO[kind.name]):
        if rule.name not in found:
            continue
        value = found[rule.name]
        if value is None and rule.name in _ESSENTIAL:
            wrong.append(f"{rule.name} cannot be read")
        elif value is not None and not rule.leaves(value):
            wrong.append(f"{rule.name} is {value:g}: {rule.otherwise}")
    if kind is not PX4 and ESTOP not in {
        found.get(f"RC{channel}_OPTION") for channel in SWITCH_CHANNELS
    }:
        wrong.append(f"no RCn_OPTION is {ESTOP}, Motor Emergency Stop: there is no kill switch")
    return wrong
