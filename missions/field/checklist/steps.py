"""What a crew does and ticks, in order, with a rig's own numbers; what its radios do; who says what.

Pure: a rig and its plan in, words out. The order is that of docs/field.md.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

from drivers.rig.parts import Rig, decode_part
from flight.plan.flown import Flown
from flight.plan.room import agreement_s, most_wind_mps
from flight.rendezvous.viewpoint import Viewpoint
from path.messages import Role

NAME = {Role.SENDER: "D1", Role.RECEIVER: "D2"}
BLANK = "_____"
RADIO = ("px4", "ardupilot")

Rows = Sequence[tuple[str, str]]
Section = tuple[str, Sequence[str]]
"""A title, and what is to be ticked below it; between backticks: what is typed."""


def numbers(rig: Rig, of: Flown) -> Iterator[tuple[str, str]]:
    """Yield the rig's numbers that a crew needs at hand."""
    mission = of.mission
    follow = mission.follow
    guard = mission.guard
    viewpoint = of.placed.viewpoint
    yield "take-off", f"D1 to {_m(mission.take_off_height_m)}, D2 to {_receiver_m(of)}"
    yield "D1 follows", f"{_m(follow.behind_m)} behind, {_m(follow.height_m)} up"
    yield "its speed", f"{follow.max_speed_mps:.1f} m/s at most"
    yield "D2 stands off", f"{_m(mission.rendezvous.stand_off_m)} from the marker"
    if isinstance(viewpoint, Viewpoint):
        yield "D2 hands over", f"{_m(math.hypot(*viewpoint.camera_h_m))} from the marker"
    yield "never nearer", f"than {_m(mission.separation.minimum_m)}: both land"
    walls = ", and the walls" if guard.corners_m else ""
    yield "fence", f"{_m(guard.fence_radius_m)} round, {_m(guard.fence_height_m)} up{walls}"
    if radios(rig):
        yield "", "3 m outside it the autopilot's own"
    yield "battery", f"a flight ends at {_least(of)}"
    yield "wind", f"planned {of.facts.site.wind_mps:g}, borne {most_wind_mps(of):.1f} m/s"
    speed_mps = of.facts.target.max_speed_mps
    yield "target", f"{_place(mission.target.north_m, mission.target.east_m)} of the origin"
    if speed_mps:
        yield "", f"{speed_mps:g} m/s at most"
    rates = [eye.rate_hz for eye in (of.facts.sender, of.facts.receiver) if eye.rate_hz is not None]
    if rates:
        least_s = agreement_s(of.facts, min(rates))
        yield "agreement", f"in {least_s:.1f} s or more, {mission.deadlines.verify_s:.0f} s at most"
    for role in Role:
        yield f"link of {NAME[role]}", _link(rig, role)


def _m(length_m: float) -> str:
    return f"{length_m:.2f}".rstrip("0").rstrip(".") + " m"


def _receiver_m(of: Flown) -> str:
    return _m(of.mission.receiver_take_off_height_m)


def _least(of: Flown) -> str:
    return f"{100.0 * of.mission.guard.min_battery:.0f} %"


def _place(north_m: float, east_m: float) -> str:
    north = f"{_m(abs(north_m))} {'north' if north_m >= 0.0 else 'south'}"
    east = f"{_m(abs(east_m))} {'east' if east_m >= 0.0 else 'west'}"
    return f"{north}, {east}"


def _link(rig: Rig, role: Role) -> str:
    options = rig.role(role).link.options
    named = [str(options[key]) for key in ("bind", "port", "baud") if key in options]
    return " ".join(named) or "its own"


def sections(
    rig: Rig,
    of: Flown,
    name: str,
) -> Iterator[Section]:
    """Yield what is to be ticked. ``name``: as ``--rig`` takes it."""
    yield "The day before", list(_before(rig, name))
    yield "At the site, propellers off", list(_site(rig, of, name))
    yield "Take-off", list(_take_off(rig, of, name))
    yield "What is seen, in this order", list(_seen(of))
    yield "Down", list(_down(name))


def _before(rig: Rig, name: str) -> Iterator[str]:
    yield f"`path-handoff rigs --check {name}` and `path-handoff plan {name}` find nothing"
    yield f"`path-handoff rehearse {name} --seeds 20`: every end is understood"
    keys = {str(rig.role(role).link.options.get("key_file", "")) for role in Role} - {""}
    key = f" and {', '.join(sorted(keys))} (mode 0600)" if keys else ""
    yield f"{rig.file.name}{key}: the same on every computer"
    for marker in rig.layout.markers:
        side = f"{1e3 * marker.side_m:.1f} ± {1e3 * marker.side_sigma_m:.1f} mm"
        yield f"marker {marker.id}: black frame {side} by calliper; flat, dull, all its white there"
    yield "batteries and transmitters charged, one more of each; the disks have room"


def _site(
    rig: Rig,
    of: Flown,
    name: str,
) -> Iterator[str]:
    mission = of.mission
    wind_mps = min(of.facts.site.wind_mps, most_wind_mps(of))
    yield f"wind {BLANK} m/s, not above {wind_mps:.1f}"
    yield f"nobody else within {_m(mission.guard.fence_radius_m)} of the origin"
    yield f"origin {rig.origin.latitude_deg:.6f}, {rig.origin.longitude_deg:.6f}: marked"
    homes = {Role.SENDER: mission.target.home_m, Role.RECEIVER: mission.rendezvous.home_m}
    for role, home in homes.items():
        options = rig.role(role).vehicle.options
        at = home or [options[key] for key in ("north_m", "east_m") if key in options]
        place = f"{_place(at[0], at[1])} of it" if len(at) == 2 else f"{BLANK} of it"
        yield f"{NAME[role]} stands {place}, level"
    yield "the marker hangs on D1 as drawn; lenses are clean; nothing is loose"
    for role in Role:
        both = "" if role is Role.SENDER else ", begun within 4 s"
        yield f"{NAME[role]}: `path-handoff doctor --rig {name} --role {role.value}`: no fault{both}"
        if kind_of(rig, role) in RADIO:
            yield f"pilot of {NAME[role]}: mode, kill and each stick are seen in the ground station"
    if rig.reference is not None and rig.reference.beacons is not None:
        yield "beacons: all are heard, none was moved since the map"


def _take_off(
    rig: Rig,
    of: Flown,
    name: str,
) -> Iterator[str]:
    yield f"batteries in: D1 {BLANK} %, D2 {BLANK} % (a flight ends at {_least(of)})"
    yield "propellers on, everybody back behind the fence"
    if radios(rig):
        yield "pilots: throttle at the bottom, thumbs on the sticks, a finger at the mode switch"
    yield "computer asks “D1?” – “D1 ready” – “D2?” – “D2 ready” – says “starting”"
    yield f"D2: `path-handoff receiver --rig {name}`"
    wait_s = of.mission.deadlines.peer_s
    yield f"D1, within {wait_s:.0f} s: `path-handoff sender --rig {name}`"
    if any(kind_of(rig, role) == "ardupilot" for role in Role):
        yield "once it flies: throttle to the middle"


def _seen(of: Flown) -> Iterator[str]:
    mission = of.mission
    yield f"D1 climbs to {_m(mission.take_off_height_m)}, D2 to {_receiver_m(of)}"
    yield "D1 goes behind the object that is meant, and behind no other"
    yield "D2 stands off, finds the marker, comes nearer; no ALARM on either screen"
    yield f"“committed”: D1 goes {_m(mission.depart_m)} aside and lands"
    yield f"D2 follows for {mission.follow_after_s:.0f} s and lands"


def _down(name: str) -> Iterator[str]:
    yield f"disarmed, batteries out: D1 {BLANK} %, D2 {BLANK} %"
    yield f"ended as {BLANK}{BLANK}{BLANK} at {BLANK}; both logs are fetched"
    yield f"first flight: `path-handoff checklist {name} --tick` and its name"


def words(rig: Rig) -> Iterator[tuple[str, str]]:
    """Yield who says what, and what it means."""
    yield "“ready”", "pilot: all is as this page says"
    yield "“starting”", "computer: the next key takes off"
    if radios(rig):
        yield "“mine”", "pilot, with the mode switch: I fly it; the other drone makes room, lands"
        yield "“kill”", "pilot, before it hits somebody: the motors stop, it falls"
    yield "“stop”", "anybody: the computer presses Ctrl-C, both land"


_SWITCHES: dict[str, Rows] = {
    "px4": (
        ("mode: POSITION", "the script lets go, it holds (RC_MAP_FLTMODE)"),
        ("a grabbed stick", "the same (COM_RC_OVERRIDE 3)"),
        ("mode: LAND, RETURN", "lands here, at home"),
        ("kill", "motors stop, in the air too (RC_MAP_KILL_SW)"),
        ("transmitter off", "holds, lands after 5 s (NAV_RCL_ACT 3)"),
    ),
    "ardupilot": (
        ("mode: LOITER", "the script lets go, it holds; at a low throttle it sinks (FLTMODE_CH)"),
        ("a grabbed stick", "nothing in GUIDED: the mode switch is the way"),
        ("mode: LAND, RTL", "lands here, at home"),
        ("kill", "motors stop, in the air too (RCn_OPTION 31)"),
        ("transmitter off", "lands (FS_THR_ENABLE 3)"),
    ),
    "tello": (
        ("none", "Ctrl-C lands it; else its power button, or a hand from below"),
        ("Wi-Fi lost", "flies on as it did for up to 15 s: have a net"),
    ),
    "none": (("none", "nobody can take this drone or stop its motors (rc = none)"),),
    "other": (("its own", "PATH does not know this driver; write them here:"),),
}


def switches(rig: Rig) -> Iterator[tuple[str, Rows]]:
    """Yield what each radio's switches do, by whose; both at once where they are alike."""
    kinds = {role: kind_of(rig, role) for role in Role}
    if len(set(kinds.values())) == 1:
        yield "D1 and D2", _SWITCHES[kinds[Role.SENDER]]
        return
    for role in Role:
        yield NAME[role], _SWITCHES[kinds[role]]


def radios(rig: Rig) -> bool:
    """Return whether a pilot has a radio."""
    return any(kind_of(rig, role) in RADIO for role in Role)


def kind_of(rig: Rig, role: Role) -> str:
    """Return what a pilot has to know of a drone: a key of the table of switches."""
    spec = rig.role(role).vehicle
    config: Any = decode_part(spec)[1]
    if spec.factory.endswith(":TelloVehicle"):
        return "tello"
    if getattr(config, "rc", "") == "none":
        return "none"
    autopilot = getattr(config, "autopilot", "px4" if rig.harness else "other")
    return autopilot if autopilot in RADIO else "other"
