"""The figures that the suite tells of a vehicle, each by its name, in the order of the table."""

from __future__ import annotations

from collections.abc import Mapping

from missions.proofs.conformance.stage import Value
from path.values import frozen


@frozen
class Row:
    """One figure.

    Attributes:
        alike: how far apart two figures may be and still count as the same: absolute, or this share
            of the larger one, whichever is more. None: not compared, such as texts in an
            autopilot's own words.
    """

    name: str
    title: str
    unit: str = ""
    alike: tuple[float, float] | None = (0.0, 0.0)
    digits: int = 2


TIME = (0.3, 0.3)
SPEED = (0.1, 0.3)
LENGTH = (0.1, 0.5)
NOISE = (0.01, 0.6)
OWN_WORDS = None

SECTIONS: dict[str, tuple[Row, ...]] = {
    "Switched on": (
        Row("heartbeat_s", "first heartbeat after", "s", (2.0, 0.0), 1),
        Row("early_arm", "told to arm at once, it answers"),
        Row("early_arm_text", "... and says", alike=OWN_WORDS),
        Row("armable_s", "its arming checks pass after", "s", (5.0, 0.3), 1),
        Row("ready_s", "the driver would fly after (checks, position, home)", "s", (5.0, 0.3), 1),
    ),
    "On the ground": (
        Row("unknown_command", "a command it does not know"),
        Row("unknown_mode", "a mode it does not know"),
        Row("take_off_disarmed", "take-off while disarmed"),
        Row("arm_s", "`arm()` takes", "s", (0.3, 0.0)),
        Row("arm_shown_s", "heartbeat shows it armed after the answer by", "s", (0.3, 0.0)),
        Row("arm_again", "arm once more"),
        Row("idle_disarm_s", "armed and left alone, disarms after", "s", (2.0, 0.0), 1),
    ),
    "Take-off to 3 m": (
        Row("lift_off_s", "off the ground after", "s", TIME, 1),
        Row("climb_mps", "fastest climb", "m/s", SPEED),
        Row("ramp_s", "from the ground to 90 % of the height", "s", TIME, 1),
        Row("take_off_s", "`take_off()` takes", "s", (1.0, 0.2), 1),
        Row("overshoot_m", "overshoot", "m", LENGTH),
        Row("mode_after_take_off", "mode afterwards"),
        Row("landed_states_up", "landed states"),
        Row("in_air_s", "shows “in air” after", "s", (1.0, 0.2), 1),
    ),
    "In the air": (
        Row("arm_in_air", "arm"),
        Row("disarm_in_air", "disarm"),
        Row("take_off_in_air", "take-off"),
        Row("take_off_in_air_then", "... mode half a second later"),
        Row("offboard_unready", "OFFBOARD (GUIDED) without setpoints"),
        Row("offboard_unready_then", "... mode 1.5 s later"),
    ),
    "Hovering for 8 s": (
        Row("height_error_m", "true height less the height asked for", "m", (0.3, 0.0)),
        Row("drift_m", "farthest from where it began, across", "m", LENGTH),
        Row("height_drift_m", "highest less lowest", "m", LENGTH),
        Row("across_bias_m", "estimate: position, mean error across", "m", (0.1, 0.6), 3),
        Row("across_std_m", "... its standard deviation", "m", NOISE, 3),
        Row("height_bias_m", "estimate: height, mean error", "m", (0.3, 0.0), 3),
        Row("height_std_m", "... its standard deviation", "m", NOISE, 3),
        Row("velocity_std_mps", "estimate: velocity across, standard deviation", "m/s", NOISE, 3),
        Row("climb_std_mps", "estimate: climb, standard deviation", "m/s", NOISE, 3),
        Row("tilt_rms_deg", "estimate: tilt, root mean square error", "°", (0.3, 0.5)),
        Row("yaw_bias_deg", "estimate: heading, mean error", "°", (2.0, 0.0)),
        Row("yaw_std_deg", "... its standard deviation", "°", (0.2, 0.5)),
    ),
    "Telemetry (50 Hz asked for; heartbeat 10 Hz, landed state 5 Hz)": (
        Row("heartbeat_hz", "heartbeat", "Hz", (0.0, 0.2), 1),
        Row("attitude_hz", "attitude", "Hz", (0.0, 0.1), 1),
        Row("attitude_gap_s", "... longest gap", "s", (0.05, 0.0), 3),
        Row("local_position_hz", "local position", "Hz", (0.0, 0.1), 1),
        Row("global_position_hz", "global position", "Hz", (0.0, 0.1), 1),
        Row("landed_state_hz", "landed state", "Hz", (0.0, 0.2), 1),
    ),
    "Setpoints": (
        Row("offboard_s", "`start_offboard()` takes", "s", (0.3, 0.0)),
        Row("step_rise_s", "0 to 1 m/s: 63 % after", "s", (0.2, 0.3)),
        Row("step_overshoot_percent", "... overshoot", "%", (10.0, 0.0), 0),
        Row("step_error_mps", "... error in the fourth second", "m/s", (0.1, 0.0)),
        Row("height_change_m", "... highest less lowest meanwhile", "m", (0.2, 0.5)),
        Row("stop_s", "back to 0: below 0.2 m/s after", "s", (0.3, 0.3), 1),
        Row("stop_m", "... within", "m", (0.2, 0.3)),
        Row("climb_rise_s", "0 to 0.5 m/s upwards: 63 % after", "s", (0.2, 0.3)),
        Row("climb_overshoot_percent", "... overshoot", "%", (10.0, 0.0), 0),
        Row("yaw_rate_dps", "turn by 90°: fastest", "°/s", (0.0, 0.3), 0),
        Row("yaw_s", "... within 5° after", "s", (0.3, 0.3), 1),
        Row("yaw_overshoot_deg", "... overshoot", "°", (4.0, 0.0), 1),
    ),
    "Another ground station selects HOLD (BRAKE) while setpoints go on": (
        Row("other_hold", "answer"),
        Row("other_hold_seen_s", "the driver sees it after", "s", (0.3, 0.0)),
        Row("other_hold_then", "mode a second later"),
    ),
    "Landing": (
        Row("descend_mps", "fastest descent", "m/s", SPEED),
        Row("touch_mps", "speed at the ground", "m/s", SPEED),
        Row("landed_states_down", "landed states"),
        Row("touch_to_ground_s", "“on ground” after the touch by", "s", (0.7, 0.0), 1),
        Row("touch_to_disarmed_s", "disarmed after the touch by", "s", (1.0, 0.0), 1),
    ),
    "Setpoints stop in OFFBOARD (GUIDED), the companion's heartbeats go on": (
        Row("silent_modes", "modes"),
        Row("silent_s", "first change after", "s", (1.0, 0.0), 1),
        Row("silent_stand_s", "stands after", "s", (0.7, 0.0), 1),
        Row("silent_stand_m", "... and", "m", (0.3, 0.3)),
        Row("silent_land_s", "LAND after", "s", (1.0, 0.0), 1),
        Row("silent_down_s", "on the ground after", "s", (1.5, 0.2), 1),
    ),
    "The cable is cut in OFFBOARD (GUIDED)": (
        Row("cut_modes", "modes"),
        Row("cut_s", "first change after", "s", (1.0, 0.0), 1),
        Row("cut_stand_s", "stands after", "s", (0.7, 0.0), 1),
        Row("cut_stand_m", "... and", "m", (0.3, 0.3)),
        Row("cut_land_s", "LAND after", "s", (1.0, 0.0), 1),
        Row("cut_down_s", "on the ground after", "s", (1.5, 0.2), 1),
    ),
    "The cable is cut in HOLD": (
        Row("cut_hold_modes", "modes"),
        Row("cut_hold_land_s", "LAND after", "s", (1.0, 0.0), 1),
        Row("cut_hold_down_s", "on the ground after", "s", (1.5, 0.2), 1),
    ),
    "A mode that needs sticks (POSCTL, LOITER), and there are none": (
        Row("pilot", "answer"),
        Row("pilot_then", "modes within 3 s"),
        Row("pilot_seen_s", "the driver sees a change after", "s", (0.5, 0.0)),
        Row("pilot_drop_m", "height lost in 3 s", "m", (0.5, 0.3)),
        Row("pilot_hold_after", "`hold()` then"),
    ),
    "Battery empty": (
        Row("battery_modes", "modes"),
        Row("battery_land_s", "LAND after", "s", (2.0, 0.3), 1),
        Row("battery_says", "what it then says is left", alike=OWN_WORDS),
    ),
    "Disarmed by force in the air, by another ground station": (
        Row("kill", "answer"),
        Row("kill_s", "disarmed after", "s", (1.0, 0.0), 1),
        Row("kill_drop_mps", "falls with", "m/s", (0.5, 0.5), 1),
    ),
}


def said(row: Row, values: Mapping[str, Value]) -> str:
    """The figure as the table shows it."""
    if row.name not in values:
        return "not measured"
    value = values[row.name]
    if value is None:
        return "never"
    if isinstance(value, str):
        return value
    return f"{value:.{row.digits}f} {row.unit}".strip()


def alike(
    row: Row,
    a: Value,
    b: Value,
) -> bool:
    """Returns whether two vehicles do the same here, as far as a mission would notice."""
    if row.alike is None or isinstance(a, str) or isinstance(b, str) or a is None or b is None:
        return a == b
    absolute, share = row.alike
    return abs(a - b) <= max(absolute, share * max(abs(a), abs(b)))


def likeness(
    row: Row,
    embedded: Mapping[str, Value],
    real: Mapping[str, Mapping[str, Value]],
) -> str:
    """Whom the embedded vehicle is like; empty where there is nothing to compare."""
    others = {name: values[row.name] for name, values in real.items() if row.name in values}
    if row.alike is None or row.name not in embedded or not others:
        return ""
    own = embedded[row.name]
    same = [name for name, value in others.items() if alike(row, own, value)]
    if len(same) > 1:
        return "both"
    if same:
        return same[0]
    numbers = [value for value in others.values() if isinstance(value, (int, float))]
    if isinstance(own, (int, float)) and len(numbers) > 1 and min(numbers) < own < max(numbers):
        return "between"
    return "**neither**"
