"""What a rig may name in ``[mission]`` and ``[method]``: what a crew measures or chooses there.

Everything else in these tables follows from what was measured (``path-handoff plan`` shows it), or
is the program's own. A rig that names it is refused, so that nobody believes in a value that says
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
    "mission.follow": "behind_m height_m gain_per_s max_speed_mps target_accel_mps2 look_round_s",
    "mission.separation": "viewpoint_m minimum_m",
    "mission.rendezvous": "positions_within_m heights_within_m home_m arrived_m arrived_speed_mps"
    " image_margin_px max_range_m",
    "mission.guard": "fence_radius_m fence_height_m min_battery telemetry_age_s",
    "mission.deadlines": "peer_s acquire_s receiver_ready_s stand_off_s search_s verify_s depart_s",
    "method": "gate hold_frames hold_s target_error mount_sigma_m mount_sigma_deg",
    "method.evidence": "alpha span_m height_m offset_sigma_m",
}
"""By table: the keys that a rig may name."""
SETTINGS = frozenset(f"{table}.{key}" for table, keys in MAY_NAME.items() for key in keys.split())


def check_settings(rig: Rig) -> None:
    """Raise RigError with every setting that a rig names and no rig may name."""
    known = set(fields_of(MissionConfig, "mission.")) | set(fields_of(MethodConfig, "method."))
    problems = Problems()
    for key in rig.named:
        # What is no field at all is refused, with a suggestion, by whoever decodes the table.
        if key in known and key not in SETTINGS:
            problems.add(rig.where(key), _why(key))
    problems.raise_any()


def fields_of(kind: type[Any], prefix: str) -> Iterator[str]:
    """Yield the dotted key of every number or word of a configuration."""
    hints = get_type_hints(kind)
    for each in dataclasses.fields(kind):
        inner = hints[each.name]
        if dataclasses.is_dataclass(inner) and isinstance(inner, type):
            yield from fields_of(inner, f"{prefix}{each.name}.")
        else:
            yield f"{prefix}{each.name}"


def _why(key: str) -> str:
    """Return what a crew is told that names what is no setting."""
    if key in STATED_ELSEWHERE:
        return f"no setting of a rig: say {STATED_ELSEWHERE[key]}"
    follows = any(key == each or key.startswith(f"{each}.") for each in DERIVED)
    said = (
        "it follows from [target], [drone] and the cameras, and `path-handoff plan` shows it"
        if follows
        else "the program knows it by itself"
    )
    return f"no setting of a rig: {said}; leave it out"


STATED_ELSEWHERE: Mapping[str, str] = {
    "mission.target.radius_m": "error_m, a third of it",
    "mission.guard.corners_m": "[site] corners_m",
    "mission.guard.clear_m": "[drone] hold_m and [site] position_m",
    "mission.follow.response_s": "[drone] response_s",
    "mission.separation.horizontal_m": "[drone] diameter_m",
    "mission.separation.vertical_m": "[drone] diameter_m",
    "mission.clock_uncertainty_s": "[link] latency_s",
    "method.min_depth_m": "[depth] min_m",
    "method.max_depth_m": "[depth] max_m",
    "method.depth_sigma_at_1m_m": "[depth] sigma_at_1m_m",
}
"""What a crew states in another table."""
