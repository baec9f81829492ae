"""Faults, switched on: in the world, on the link, and at a drone's program."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from drivers.interfaces import FlightMode, PartError
from drivers.rig.parts import Rig
from hil.autopilot.autopilot import Autopilot
from hil.autopilot.radio import STICKS_SLOT, Transmitter
from hil.harness.drone import DroneHarness, present_s
from hil.harness.programs import Programs
from hil.link.faulty import FaultyLink
from hil.world.faults import Fault
from hil.world.world import Fleet
from path.messages import Role

SAGGED = 0.15
RC = "rc_"
STEP = "step_"
GRABBED = (0.0, -0.6, 0.0, 0.0)  # the right stick pulled back: away from what is ahead
# after these it is his, or holds and waits for him
THE_PILOTS = ("pilot_takeover", "rc_mode", "rc_sticks", "rc_lost")

_OF_LINK = {
    "link_loss": ("loss",),
    "link_delay": ("delay_s", "jitter_s"),
    "link_jitter": ("jitter_s",),
    "link_duplicate": ("duplicate",),
    "link_corrupt": ("corrupt",),
    "link_reorder": ("reorder",),
}


WEATHER = ("wash", "compass", "leg", "slope", "exposure", "smudge")
_OF_DETECTOR = {
    "detector_recall": "recall",
    "detector_miss_frames": "miss_frames",
    "detector_false": "false_positives",
    "detector_bias": "edge_px",
}


def need_own_estimators(rig: Rig, faults: Sequence[Fault]) -> None:
    """Raise PartError when the estimator of another program is to step."""
    for fault in faults:
        if fault.name.startswith(STEP) and "sender_simulator" in rig.world:
            raise PartError(
                f"fault {fault.name}: the estimators of {rig.where('world')} are the autopilots' own",
                "use a rig with embedded vehicles: sim, sitl",
            )


def need_radios(rig: Rig, faults: Sequence[Fault]) -> None:
    """Raise PartError when a pilot without a transmitter is to use one."""
    for fault in faults:
        role = fault.kind.role
        if role is None or not (fault.name.startswith(RC) or fault.name == "motor_kill"):
            continue
        if "sender_simulator" in rig.world and rig.role(role).vehicle.options.get("rc") == "none":
            raise PartError(
                f'fault {fault.name}: {rig.where(f"{role.value}.vehicle")} says rc = "none"',
                "name a rig whose pilots have radios: sitl-px4-field, sitl-ardupilot-field",
            )


def inject_in_world(
    name: str,
    role: str | None,
    world: Fleet,
    value: float | None = None,
    leg: Sequence[str] = tuple(Role),
    target: int = 0,
) -> None:
    """A fault of the world; any other changes nothing here.

    Args:
        role: the drone that it is of.
        leg: the sender and the receiver, between which it is; of which ``target`` it is.
    """
    match name:
        case "lookalike":
            world.send_lookalike(target)
        case "marker_hidden":
            world.hide_marker(leg[0], math.inf if value is None else value)
        case "depth_holes":
            world.depth_holes(*leg)
        case "pilot_takeover" | "motor_kill" if role is not None:
            _by_pilot(name, world.drone(role).autopilot, world.time_s)
        case _ if role is not None and name.startswith(RC):
            away_until_s = world.time_s + (math.inf if value is None else value)
            _at_transmitter(name, world.drone(role).autopilot.radio.transmitter, away_until_s)
        case _ if role is not None and name.startswith(STEP):
            _step_estimator(name, role, world, value or 0.0)
        case _ if name in _OF_DETECTOR:
            world.degrade_detectors(**{_OF_DETECTOR[name]: value or 0.0})
        case "no_failsafe":
            for drone in world.names:
                autopilot = world.drone(drone).autopilot
                autopilot.config = replace(autopilot.config, offboard_loss_s=math.inf)
        case "battery_sag" if role is not None:
            world.battery(role, SAGGED if value is None else value)
        case _ if name in WEATHER:
            setattr(world.air if name == "wash" else world.weather, name, value or 0.0)
        case _:
            pass


def _by_pilot(name: str, autopilot: Autopilot, now_s: float) -> None:
    if name == "motor_kill":
        autopilot.kill(now_s)
    else:
        autopilot.request_mode(now_s, FlightMode.OTHER, by_pilot=True)


def _step_estimator(name: str, drone: str, world: Fleet, by: float) -> None:
    """``by``: in metres north, east or up, or in degrees clockwise."""
    match name.removeprefix(STEP).partition("_")[0]:
        case "north":
            world.step_estimator(drone, (by, 0.0, 0.0), 0.0)
        case "east":
            world.step_estimator(drone, (0.0, by, 0.0), 0.0)
        case "height":
            world.step_estimator(drone, (0.0, 0.0, -by), 0.0)
        case _:
            world.step_estimator(drone, (0.0, 0.0, 0.0), math.radians(by))


def _at_transmitter(name: str, held: Transmitter, away_until_s: float) -> None:
    what = name.removeprefix(RC).partition("_")[0]
    if what == "mode":
        held.slot = STICKS_SLOT
    elif what == "kill":
        held.kill = True
    elif what == "sticks":
        held.sticks = GRABBED
    elif what == "lost":
        held.away_until_s = away_until_s


def inject_in_leg(
    fault: str,
    drone: str | None,
    world: Fleet,
    value: float | None,
    leg: Sequence[str],
    target: int,
) -> None:
    """A fault of the world in a leg of many, whose pilots land what they took over."""
    inject_in_world(fault, drone, world, value, leg, target)
    if drone is not None and fault.startswith(THE_PILOTS):
        world.pilot_lands(drone)


def inject_on_link(name: str, value: float, link: FaultyLink[Any]) -> None:
    """A fault of the link beside those that are there already; any other changes nothing here."""
    if name == "link_out":
        link.interrupt(value)
    elif name in _OF_LINK:
        link.faults = replace(link.faults, **dict.fromkeys(_OF_LINK[name], value))


def inject_at_drone(fault: Fault, name: str, drone: DroneHarness, programs: Programs) -> None:
    """A fault of one drone's camera, cable or program; any other changes nothing here."""
    if fault.name == "camera_freeze":
        drone.frozen = True
    elif fault.name == "fc_link_loss":
        drone.silent = drone.lost = True
    if fault.cuts_off is not None:
        drone.cut_off_s.append(present_s())
    if fault.kills is not None:
        programs.kill(name, fault.value)
    elif fault.stalls:
        programs.stall(name, fault.value or 0.0)
    elif fault.forgets:
        programs.disk(name).loses = round(fault.value or 0.0)
