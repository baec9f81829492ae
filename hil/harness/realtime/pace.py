"""The check that a computer kept up with a run in real time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

LEFT_OUT = 0.5  # of the pictures
OLD_S, OLD_SHARE = 0.25, 0.2  # of the frames, when a program took them up
ENOUGH = 50  # frames
STOOD_S = 0.5  # of a world: for longer no drone takes a silent vehicle for a living one


def overload_of(
    ages_s: Mapping[str, Sequence[float]], pictures: Mapping[str, Any], whose: str = "{}'s", stood_s: float = 0.0
) -> str:
    """Returns what was late, and how late; empty when all kept up.

    Args:
        ages_s: of each drone's frames, from their capture until its program took them up.
        pictures: by drone, how many were ``rendered`` and how many ``left_out`` because it was too late for them.
        whose: how something of a drone is called.
        stood_s: for how long the world stood still at the most while drones flew.
    """
    late = [f"the world stood still for {stood_s:.1f} s"] if stood_s > STOOD_S else []
    for name in dict.fromkeys((*ages_s, *pictures)):
        made, its = pictures.get(name, {}), whose.format(name)
        rendered, left_out = int(made.get("rendered", 0)), int(made.get("left_out", 0))
        if rendered + left_out >= ENOUGH and left_out > LEFT_OUT * (rendered + left_out):
            late.append(f"{its} pictures: {left_out} of {rendered + left_out} were not rendered in time")
        late += late_program(f"{its} program", ages_s.get(name, ()))
    return "; ".join(late)


def frame_age_s(topic: str, record: Mapping[str, Any]) -> list[float]:
    """Returns how old a frame was when it was taken up; nothing for a record that is of none."""
    return [float(record["age_ns"]) * 1e-9] if topic == "/frame" else []


def late_program(name: str, ages_s: Sequence[float]) -> list[str]:
    """Returns what is said of a program whose frames were old when it took them up; nothing of one that kept up."""
    ages = sorted(ages_s)
    old = sum(age > OLD_S for age in ages)
    if len(ages) < ENOUGH or old <= OLD_SHARE * len(ages):
        return []
    return [f"{name}: {old} of {len(ages)} frames were late, a tenth by {ages[int(0.9 * len(ages))]:.2f} s"]
