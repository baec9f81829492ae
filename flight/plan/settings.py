"""What a rig may name in ``[mission]`` and ``[method]``: what a crew measures or chooses there.

What follows from that (``path-handoff plan`` shows it) may be named too, and then holds. The rest is
the program's own: a rig that names it is refused, so that nobody believes in a value that says
nothing any more.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any, get_type_hints

from drivers.rig.facts import DERIVED
from drivers.rig.parts import Rig
from drivers.rig.tables import Problems
from flight.config import MissionConfig
from path.config import MethodConfig

MAY_NAME: Mapping[str, str] = {
    "mission": "needs heading_deg take_off_height_m receiver_take_off_height_m max_accel_mps2"
    " follow_hz record image_hz follow_after_s attitude_sigma_deg attitude_wander_deg"
    " height_sigma_m level_ground",
    "mission.target": "north_m east_m height_m half_size_m flies error_m home_m age_s"
    " velocity_mps holds_s fastest_mps",
    "mission.follow": "behind_m height_m max_speed_mps",
    "mission.separation": "viewpoint_m minimum_m",
    "mission.rendezvous": "positions_within_m heights_within_m home_m arrived_m arrived_speed_mps"
    " image_margin_px max_range_m",
    "mission.guard": "fence_radius_m fence_height_m min_battery telemetry_age_s",
    "mission.deadlines": "peer_s acquire_s receiver_ready_s stand_off_s search_s verify_s depart_s",
    "method": "gate tau_min tau_max hold_frames hold_s target_error mount_sigma_m mount_sigma_deg"
    " common_view",
    "method.evidence": "alpha span_m height_m offset_sigma_m",
}
"""By table: the settings of a rig."""
SETTINGS = frozenset(f"{table}.{key}" for table, keys in MAY_NAME.items() for key in keys.split())


def check_settings(rig: Rig) -> None:
    """Raise RigError with everything that a rig names and that is the program's own."""
    known = set(fields_of(MissionConfig, "mission.")) | set(fields_of(MethodConfig, "method."))
    problems = Problems()
    for key in rig.named:
        # What is no field at all is refused, with a suggestion, by whoever decodes the table.
        if key in known and not may_name(key):
            problems.add(rig.where(key), "no setting of a rig: the program knows it by itself")
    problems.raise_any()


def may_name(key: str) -> bool:
    """Return whether a rig may name a key: a setting, what is derived, or what another table says
    too.
    """
    derived = any(key == each or key.startswith(f"{each}.") for each in DERIVED)
    return key in SETTINGS or derived or key in STATED_ELSEWHERE


def fields_of(kind: type[Any], prefix: str) -> Iterator[str]:
    """Yield the dotted key of every number or word of a configuration."""
    hints = get_type_hints(kind)
    for each in dataclasses.fields(kind):
        inner = hints[each.name]
        if dataclasses.is_dataclass(inner) and isinstance(inner, type):
            yield from fields_of(inner, f"{prefix}{each.name}.")
        else:
            yield f"{prefix}{each.name}"


STATED_ELSEWHERE = frozenset(
    (
        "mission.target.radius_m",
        "mission.guard.corners_m",
        "mission.guard.clear_m",
        "mission.guard.obstacles",
        "mission.guard.unmeasured",
        "mission.follow.response_s",
        "mission.separation.horizontal_m",
        "mission.separation.vertical_m",
        "mission.clock_uncertainty_s",
        "method.min_depth_m",
        "method.max_depth_m",
        "method.depth_sigma_at_1m_m",
    )
)
"""Older names of what [drone], [site], [link], [depth] and ``error_m`` say."""
