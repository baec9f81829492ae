"""The picture of a flight's moment that the live page draws: plain dictionaries, made of what the
drones' logs told (``drone``). Pure.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

from flight.phases import Phase, words_of
from missions.look.live.alarms import ALARM, GOOD, WARNING
from missions.look.live.drone import Drone, Record, Snapshot
from path.geometry.rotation import yaw_of

SAME_PAIR_NS = 60_000_000  # a mapped box is drawn over an image that is no farther off
NEAR_TIMES = 1.5  # of the least separation: from there on it is what matters
LINK_NS = 2_500_000_000  # the link's counters are logged once a second while there is a link
SILENT_S = 3.0  # a program that flies writes ten times a second


def shown_of(drone: Drone, now_s: float) -> Snapshot:
    silent_s = now_s - drone.heard_s
    state = drone.state
    guard = {} if drone.setup is None else drone.setup["mission"]["guard"]
    shown: Snapshot = {
        "name": drone.name,
        "short": drone.short,
        "phase": drone.phase,
        "words": words_of(drone.phase),
        "note": drone.note,
        "silent_s": round(silent_s, 1) if silent_s > SILENT_S else None,
        "place_m": None,
        "least_battery": guard.get("min_battery"),
        "link": link_of(drone),
        "late_ms": _late_ms(drone),
        "responsible": drone.responsible
        and (drone.responsible_until_ns is None or drone.newest_ns < drone.responsible_until_ns),
        "image_ns": None if drone.image is None else drone.image[0],
        "overlays": [] if drone.image is None else overlays_at(drone.image[0], drone.overlays),
        "outcome": None if drone.outcome is None else drone.outcome["outcome"],
        "detail": None if drone.outcome is None else drone.outcome["detail"],
    }
    if state is not None:
        velocity = state["velocity_n_mps"]
        shown |= {
            "place_m": drone.in_crews_frame(state["position_n_m"]),
            "height_m": round(-state["position_n_m"][2], 2),
            "heading_rad": round(yaw_of(tuple(state["q_n_b"])), 3),
            "speed_mps": round(math.hypot(*velocity[:2]), 2),
            "mode": state["mode"],
            "armed": state["armed"],
            "battery": state["battery"],
            "gps_fix": state.get("gps_fix"),
            "satellites": state.get("satellites"),
            # a flight without a pilot's radio misses none
            "radio": bool(state.get("radio")) if drone.heard_radio else None,
        }
    return shown


def overlays_at(image_ns: int, overlays: Iterable[tuple[int, str, Any]]) -> list[Snapshot]:
    """Return what was found in the image that is shown, and of no other frame: px of it."""
    found: dict[str, tuple[int, Any]] = {}
    for utc_ns, kind, what in overlays:
        off_ns = abs(utc_ns - image_ns)
        most_ns = SAME_PAIR_NS if kind == "mapped" else 0
        if off_ns <= most_ns and (kind not in found or off_ns < found[kind][0]):
            found[kind] = (off_ns, what)
    return [{"kind": kind, "px": list(what)} for kind, (_, what) in found.items()]


def _late_ms(drone: Drone) -> float | None:
    """Return how late its program was when it last said so, ms; None when it never was."""
    late = drone.lately("/late")
    if late is None:
        return None
    return round(1e-6 * max(late["loop_ns"] or 0, late["waited_ns"] or 0), 1)


def link_of(drone: Drone) -> Snapshot | None:
    """Return what came in over the link in the last second or two: packets and bytes a second."""
    if len(drone.links) < 2 or drone.newest_ns - drone.links[-1][0] > LINK_NS:
        return None
    (first_ns, first), (last_ns, last) = drone.links[0], drone.links[-1]
    seconds = max((last_ns - first_ns) * 1e-9, 1e-3)
    received = last["packets_received"] - first["packets_received"]
    return {
        "heard": last["packets_received"],
        "heard_per_s": round(received / seconds, 1),
        "kb_per_s": round((last["bytes_received"] - first["bytes_received"]) / seconds / 1e3, 2),
        "sent_kb_per_s": round((last["bytes_sent"] - first["bytes_sent"]) / seconds / 1e3, 2),
        "dropped": sum((last["dropped"] or {}).values()) - sum((first["dropped"] or {}).values()),
    }


def separation_of(shown: Sequence[Drone]) -> Snapshot | None:
    """Return how far the two drones are apart, by D2's view of the marker where there is one, else
    by what their positions say; and the least that they may be.
    """
    setup = next((drone.setup for drone in shown if drone.setup is not None), None)
    if setup is None:
        return None
    limit_m = setup["mission"]["separation"]["minimum_m"]
    for drone in shown:
        marker = drone.lately("/marker")
        if marker is not None and marker["position_v_m"] is not None:
            apart_m = math.hypot(*marker["position_v_m"])
            return {"m": round(apart_m, 3), "limit_m": limit_m, "by": "marker"}
    flying = [drone for drone in shown if drone.state is not None]
    if len(flying) != 2:
        return None
    places = [
        (*drone.in_crews_frame(drone.state["position_n_m"]), drone.state["position_n_m"][2])
        for drone in flying
        if drone.state is not None
    ]
    return {"m": round(math.dist(*places), 3), "limit_m": limit_m, "by": "positions"}


def evidence_of(shown: Sequence[Drone]) -> Snapshot | None:
    """Return how much speaks for the same object, of what is needed; None outside of a
    comparison.
    """
    for drone in shown:
        # what comes in after the commit is of no account
        counts = drone.phase == Phase.VERIFY.title and drone.responsible
        pair = drone.lately("/agreement") if counts else None
        if pair is not None:
            return {
                "reached": pair["evidence"],
                "needed": pair["evidence_needed"],
                "pairs": pair["count"],
                "pairs_needed": pair["needed"],
                "agreed": pair["agreed"],
                "reason": pair["reason"],
            }
    return None


def matters(now: Snapshot) -> Snapshot:
    """Return the one number that matters now: what it is, its value, what it needs to be, and how
    bad that is.
    """
    apart = now["separation"]
    pair = now["evidence"]
    ends = [drone for drone in now["drones"] if drone["outcome"] is not None]
    if ends and len(ends) == len(now["drones"]):
        outcome = next((e["outcome"] for e in ends if e["outcome"] not in GOOD), ends[0]["outcome"])
        level = "good" if outcome in GOOD else ALARM
        return {"what": "The flight has ended", "value": outcome, "of": "", "level": level}
    flying = sum(bool(drone.get("armed")) for drone in now["drones"]) > 1
    if apart is not None and flying and apart["m"] < NEAR_TIMES * apart["limit_m"] and pair is None:
        level = ALARM if apart["m"] < apart["limit_m"] else WARNING
        of = f"of at least {apart['limit_m']:.2f} m"
        return {"what": "Apart", "value": f"{apart['m']:.2f} m", "of": of, "level": level}
    if pair is not None:
        reached, needed = pair["reached"], pair["needed"]
        if reached is None or needed is None:
            reached, needed = float(pair["pairs"]), float(pair["pairs_needed"])
        level = "good" if pair["agreed"] else WARNING
        of = f"of {needed:.1f} needed"
        return {"what": "Evidence", "value": f"{reached:.1f}", "of": of, "level": level}
    holder = next((drone for drone in now["drones"] if drone["responsible"]), None)
    if holder is not None:
        return {"what": "Has the target", "value": holder["short"], "of": "", "level": "good"}
    if apart is not None and flying:
        of = f"of at least {apart['limit_m']:.2f} m"
        return {"what": "Apart", "value": f"{apart['m']:.2f} m", "of": of, "level": "good"}
    return {"what": "Nobody has the target", "value": "", "of": "", "level": "good"}


def site_of(setup: Record) -> Snapshot:
    """Return the fence and the walls, m from the origin, and what is kept out of: a strip along
    the walls, and the place about each drone.
    """
    guard = setup["mission"]["guard"]
    return {
        "radius_m": guard["fence_radius_m"],
        "height_m": guard["fence_height_m"],
        "corners_m": [list(corner) for corner in guard.get("corners_m") or ()],
        "clear_m": guard.get("clear_m") or 0.0,
        "apart_m": setup["mission"]["separation"]["minimum_m"],
    }
