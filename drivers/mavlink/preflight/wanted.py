"""The values that a rig may want of an autopilot's safety parameters, judged before anything is
written.

One table, of every parameter that docs/field.md and docs/autopilots.md name: what a rig wants is
held against it when the rig is read (so in ``rigs --check``, ``doctor`` and every flight alike),
and what a vehicle's fence does is held against the same rows. Meanings are those of PX4 1.17.0's
and ArduCopter 4.7-dev's own parameter descriptions.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping

from drivers.mavlink.preflight.pilot_rules import SILENCING
from path.values import frozen

LONGEST_WITHOUT_SETPOINTS_S = 2.0
# one that no pilot can take: its failsafe waits while what comes before it is measured
LONGEST_OF_A_SIMULATOR_S = 10.0
LONGEST_WITHOUT_COMPANION_S = 5.0  # as ArduCopter is delivered
# bits of FENCE_TYPE
ALT_MAX = 1
CIRCLE = 2
# of RTL_ALT: as high as a fence may be; what is less was meant in metres
HIGHEST_CM = 12_000.0
LEAST_CM = 100.0


@frozen
class WantedRule:
    """One parameter.

    Attributes:
        good: whether a value is safe for a flight by a companion computer.
        otherwise: what goes wrong with one that is not, and what is right.
        whole: it is an enumeration or a set of bits: 2.6 is none.
        with_radio: it matters only where a pilot has a radio.
    """

    name: str
    good: Callable[[float], bool]
    otherwise: str
    whole: bool = True
    with_radio: bool = False


def _one_of(*values: int) -> Callable[[float], bool]:
    return lambda value: round(value) in values


def _within(least: float, most: float) -> Callable[[float], bool]:
    return lambda value: least < value <= most


def _all_bits(bits: int) -> Callable[[float], bool]:
    return lambda value: round(value) & bits == bits


def _no_bits(bits: int) -> Callable[[float], bool]:
    return lambda value: not round(value) & bits


def _positive(value: float) -> bool:
    return value > 0.0


def _height_cm(value: float) -> bool:
    return value == 0.0 or LEAST_CM <= value <= HIGHEST_CM


RULES = (
    *(WantedRule(rule.name, rule.leaves, rule.otherwise) for rule in SILENCING),
    WantedRule(
        "GF_ACTION",
        _one_of(2, 3, 5),
        "0 and 1 do nothing at its fence, 4 stops the motors: 2 holds, 5 lands",
    ),
    WantedRule("GF_MAX_HOR_DIST", _positive, "0 is no fence", whole=False),
    WantedRule("GF_MAX_VER_DIST", _positive, "0 is no ceiling", whole=False),
    WantedRule(
        "COM_OF_LOSS_T",
        _within(0.0, LONGEST_WITHOUT_SETPOINTS_S),
        f"without setpoints it is to land within {LONGEST_WITHOUT_SETPOINTS_S:g} s: 0.5",
        whole=False,
    ),
    WantedRule(
        "COM_OBL_RC_ACT",
        _one_of(3, 4),
        "without setpoints 0 to 2 leave it to a pilot who may not be looking, 5 holds for ever, 6 and 7 stop the "
        "motors: 4 lands, 3 returns",
    ),
    WantedRule(
        "NAV_DLL_ACT",
        _one_of(0, 1, 2, 3),
        "5 and 6 stop the motors when a ground station leaves: 0 flies on",
    ),
    WantedRule(
        "COM_LOW_BAT_ACT",
        _one_of(1, 2, 3),
        "0 only warns, and falls with an empty battery: 2 lands",
    ),
    WantedRule(
        "NAV_RCL_ACT",
        _one_of(1, 2, 3),
        "0 does nothing when the radio is lost, 5 and 6 stop the motors: 3 lands",
    ),
    WantedRule(
        "COM_RC_OVERRIDE",
        _all_bits(2),
        "grabbed sticks would not take over from OFFBOARD: 3",
        with_radio=True,
    ),
    WantedRule(
        "COM_RCL_EXCEPT",
        _no_bits(4),
        "bit 2 flies on in OFFBOARD without a radio: 0",
        with_radio=True,
    ),
    WantedRule("RC_MAP_FLTMODE", _positive, "no channel is the mode switch", with_radio=True),
    WantedRule("RC_MAP_KILL_SW", _positive, "no channel is the kill switch", with_radio=True),
    WantedRule(
        "FENCE_ACTION",
        _one_of(1, 2, 3, 4, 5),
        "0 does nothing at its fence: 4 brakes, 2 lands",
    ),
    WantedRule("FENCE_ENABLE", _one_of(1), "0 is no fence"),
    WantedRule(
        "FENCE_TYPE",
        _all_bits(ALT_MAX | CIRCLE),
        "1 is the ceiling and 2 the circle: both are needed, 3 or 7",
    ),
    WantedRule("FENCE_RADIUS", _positive, "0 is no fence", whole=False),
    WantedRule("FENCE_ALT_MAX", _positive, "0 is no ceiling", whole=False),
    WantedRule(
        "FS_GCS_ENABLE",
        _one_of(1, 3, 4, 5, 6, 7),
        "0 and 2 fly on when the companion's program dies: 5 lands",
    ),
    WantedRule(
        "FS_GCS_TIMEOUT",
        _within(0.0, LONGEST_WITHOUT_COMPANION_S),
        f"without the companion it is to land within {LONGEST_WITHOUT_COMPANION_S:g} s: 2",
        whole=False,
    ),
    WantedRule(
        "RTL_ALT",
        _height_cm,
        "centimetres, as 300, or 0 for the height it has",
        whole=False,
    ),
    WantedRule("LAND_REPOSITION", _one_of(0, 1), "it is 0 or 1"),
    WantedRule(
        "FS_THR_ENABLE",
        _one_of(1, 3, 4, 5, 6, 7),
        "0 would not notice a lost radio: 3 lands",
        with_radio=True,
    ),
    WantedRule(
        "FS_OPTIONS",
        _no_bits(4),
        "bit 2 flies on in GUIDED without a radio: 16",
        with_radio=True,
    ),
    WantedRule("FLTMODE_CH", _positive, "no channel is the mode switch", with_radio=True),
)
BY_NAME = {rule.name: rule for rule in RULES}
COMPANION = ("MAV_GCS_SYSID", "SYSID_MYGCS")
"""Who ArduCopter's failsafe takes for the companion: newer and older name."""


def wrong(
    name: str,
    value: float,
    *,
    radio: bool = True,
) -> str:
    """Return what is wrong with one value, in words; empty when it is safe, or nothing is known of
    the parameter.
    """
    rule = BY_NAME.get(name)
    if rule is None or (rule.with_radio and not radio):
        return ""
    if not math.isfinite(value):
        return f"{name} = {value}: no number"
    if rule.whole and value != round(value):
        return f"{name} = {value:g}: no whole number ({rule.otherwise})"
    return "" if rule.good(value) else f"{name} = {value:g}: {rule.otherwise}"


def refused(
    wanted: Mapping[str, float],
    *,
    radio: bool,
    companion_id: int,
) -> Collection[str]:
    """Return those of a rig's wanted parameters that it may not want, each with its reason.

    Args:
        wanted: by name.
        radio: whether a pilot has one.
        companion_id: our own system id, which a failsafe has to watch.
    """
    judged = {
        name: value
        for name, value in wanted.items()
        if radio or not _waits_to_be_measured(name, value)
    }
    reasons = [wrong(name, value, radio=radio) for name, value in judged.items()]
    for name in COMPANION:
        if name in wanted and wanted[name] != companion_id:
            other = f"its failsafe would not watch this program, own_sysid {companion_id}"
            reasons.append(f"{name} = {wanted[name]:g}: {other}")
    return [reason for reason in reasons if reason]


def _waits_to_be_measured(name: str, value: float) -> bool:
    """Return whether this is PX4's failsafe for setpoints, made to wait while the guard is
    measured.
    """
    return name == "COM_OF_LOSS_T" and 0.0 < value <= LONGEST_OF_A_SIMULATOR_S
