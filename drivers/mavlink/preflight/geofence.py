"""The autopilot's own fence: a cylinder around its home, one step wider than the script's, by its
parameters.

The script's fence is around the mission's origin and above the height that the rig names; the
autopilot's is around and above its home, which is where it is armed. PX4 measures both from its
estimate of home and position (GF_SOURCE 0), so its ceiling moves with its altitude; ArduCopter
keeps FENCE_MARGIN inside.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from drivers.mavlink.modes import PX4, AutopilotKind
from drivers.mavlink.preflight.wanted import ALT_MAX, CIRCLE, wrong
from path.values import frozen

STEP_M = 3.0
PX4_NAMES = ("GF_MAX_HOR_DIST", "GF_MAX_VER_DIST", "GF_ACTION")
ARDUPILOT_NAMES = ("FENCE_RADIUS", "FENCE_ALT_MAX", "FENCE_ACTION", "FENCE_TYPE", "FENCE_ENABLE")


@frozen
class Geofence:
    """The script's: around the mission's origin, above the height that the rig's ``height_from``
    counts from.
    """

    radius_m: float
    height_m: float


@frozen
class FencePlan:
    """The changes that an autopilot's fence needs.

    Attributes:
        set_to: parameters to be written, by name.
        problems: why this vehicle is not to be flown, whatever is written.
    """

    set_to: Mapping[str, float]
    problems: tuple[str, ...] = ()


def names_of(kind: AutopilotKind) -> tuple[str, ...]:
    return PX4_NAMES if kind is PX4 else ARDUPILOT_NAMES


def plan_fence(
    kind: AutopilotKind,
    found: Mapping[str, float | None],
    fence: Geofence,
    home_n_m: tuple[float, float, float],
) -> FencePlan:
    """Hold what a vehicle has against what it should have.

    A wider fence, or none, is drawn in. One that is narrower than the script's is a crew's own and
    stays: the script would fly into it.

    Args:
        found: the parameters of ``names_of``, None for one that was not read.
        home_n_m: where it stands, in the mission's frame, NED.
    """
    names = names_of(kind)
    unread = [name for name in names if found.get(name) is None]
    if unread:
        return FencePlan({}, (f"its fence cannot be read back: {', '.join(unread)}",))
    has = {name: float(found[name] or 0.0) for name in names}
    north, east, down = home_n_m
    within_m = (fence.radius_m + math.hypot(north, east), fence.height_m + down)
    set_to: dict[str, float] = {}
    problems: list[str] = []
    if not (math.hypot(north, east) < fence.radius_m and -down < fence.height_m):
        problems.append(
            f"it stands outside the script's fence, at ({north:.1f}, {east:.1f}) m, height {-down:.1f} m"
        )
    on = kind is PX4 or (has["FENCE_ENABLE"] > 0.0)
    bits = (ALT_MAX | CIRCLE) if kind is PX4 else round(has["FENCE_TYPE"])
    for name, least_m, bit in zip(names, within_m, (CIRCLE, ALT_MAX), strict=False):
        wanted_m = float(math.ceil(least_m + STEP_M))
        there = on and bool(bits & bit) and has[name] > 0.0
        if there and has[name] < least_m:
            problems.append(
                f"{name} is {has[name]:g} m, inside the script's own fence of {least_m:.1f} m from there"
            )
        elif not there or has[name] > wanted_m + STEP_M:
            set_to[name] = wanted_m
    action = "GF_ACTION" if kind is PX4 else "FENCE_ACTION"
    if bad := wrong(action, has[action]):
        problems.append(bad)
    if kind is not PX4:
        if bits & (ALT_MAX | CIRCLE) != ALT_MAX | CIRCLE:
            set_to["FENCE_TYPE"] = float(bits | ALT_MAX | CIRCLE)
        if not on:
            set_to["FENCE_ENABLE"] = 1.0
    return FencePlan(set_to, tuple(problems))
