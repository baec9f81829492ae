"""What the crew must not miss: things that were said once, and things that hold at this moment.

An event is said by a log and stays in the list; its number only grows, so that the page sounds once
for each. What holds now (too near, silent, battery low) is asked anew for every picture.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

from drivers.log.foxglove import LINES

Record = Mapping[str, Any]
Event = dict[str, Any]

ALARM = "alarm"  # large, and sounds
WARNING = "warning"  # large, and is silent
TOLD = "told"  # a line among the others
KEPT = 40
FIXED = 3  # from this GPS_FIX_TYPE on it has a place and a height
LEVEL_OF = {
    "/violation": ALARM,
    "/guard": ALARM,
    "/guard_stalled": ALARM,
    "/guard_alarm": WARNING,
    "/fault": WARNING,
    "/shed": WARNING,
    "/estimator_step": WARNING,
    "/doubt": WARNING,
    "/refused": WARNING,
    "/commit": TOLD,
    "/decision": TOLD,
    "/told": TOLD,
    "/taken": TOLD,
}
WORDS: Mapping[str, Callable[[Record], str]] = {
    "/guard_stalled": lambda r: f"the guard stood still for {r['stalled_s']:.2f} s",
    "/shed": lambda r: f"too slow a computer: {'without' if r['gone'] else 'again'} {r['what']}",
    "/estimator_step": lambda r: f"its position stepped by {math.hypot(*r['shift_n_m']):.2f} m",
    "/doubt": lambda r: f"has the pilot taken it? mode {r['mode']}",
    "/told": lambda r: f"was told a {r['kind']}" + ("" if r["used"] else ", too late"),
    "/taken": lambda r: "takes the object at {:.1f} m north, {:.1f} m east".format(
        *r["position_n_m"]
    ),
}
GOOD = ("committed", "flown")


class Alarms:
    """The events of a flight, the newest last."""

    def __init__(self) -> None:
        self._events: deque[Event] = deque(maxlen=KEPT)
        self._said = 0

    def take(
        self,
        who: str,
        topic: str,
        utc_ns: int,
        record: Record,
    ) -> None:
        """Take up a record, if it is one that is told."""
        if topic == "/outcome":
            good = record["outcome"] in GOOD
            self.say(utc_ns, TOLD if good else ALARM, who, LINES[topic](record))
        elif topic == "/alike" and record["differing"]:
            self.say(utc_ns, ALARM, who, f"not alike: {record['differing']}")
        elif topic == "/operator":
            self.say(utc_ns, TOLD if record["done"] else WARNING, who, LINES[topic](record))
        elif topic in LEVEL_OF:
            self.say(utc_ns, LEVEL_OF[topic], who, (WORDS.get(topic) or LINES[topic])(record))

    def say(
        self,
        utc_ns: int,
        level: str,
        who: str,
        text: str,
    ) -> None:
        """Add an event; what is said again at once counts once more instead."""
        newest = self._events[-1] if self._events else None
        if newest is not None and (newest["of"], newest["text"]) == (who, text):
            newest["times"] += 1
            return
        self._said += 1
        said = {"number": self._said, "utc_ns": utc_ns, "level": level, "times": 1}
        self._events.append({**said, "of": who, "text": text})

    def newest(self) -> list[Event]:
        """Return what was said, the oldest first."""
        return [dict(event) for event in self._events]


def holding(now: Mapping[str, Any]) -> list[Event]:
    """Return what is wrong at this moment, by a picture of ``flight_state``: the worst first."""
    wrong: list[Event] = []

    def say(
        level: str,
        who: str,
        text: str,
    ) -> None:
        wrong.append({"level": level, "of": who, "text": text})

    all_fly = all(drone["outcome"] is None for drone in now["drones"])
    apart = now["separation"]
    if apart is not None and apart["m"] < apart["limit_m"]:
        flying = [drone for drone in now["drones"] if drone.get("armed")]
        if len(flying) > 1:
            say(ALARM, "both", f"too close: {apart['m']:.2f} m of {apart['limit_m']:.2f} m")
    for drone in now["drones"]:
        who = drone["short"]
        battery = drone.get("battery")
        least = drone["least_battery"]
        ended = drone["outcome"] is not None
        if battery is not None and least is not None and not ended:
            if battery < least:
                say(ALARM, who, f"battery {100.0 * battery:.0f} %")
            elif battery < 1.5 * least:
                say(WARNING, who, f"battery {100.0 * battery:.0f} %")
        if drone.get("armed") and not ended:
            fix = drone["gps_fix"]
            if fix is not None and fix < FIXED:
                say(WARNING, who, "its GPS has no place")
            if drone["radio"] is False:
                say(WARNING, who, "has lost the pilot's radio")
        if drone["silent_s"] is not None and not ended:
            say(ALARM, who, f"nothing logged for {drone['silent_s']:.0f} s")
        link = drone["link"]
        silent = link is not None and link["heard"] > 0 and link["heard_per_s"] == 0.0
        if silent and drone.get("armed") and all_fly:
            say(ALARM, who, "hears nothing of the other drone")
    return sorted(wrong, key=lambda each: each["level"] != ALARM)
