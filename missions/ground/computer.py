"""This computer's room for a role: the time of a frame by stage, and the frames a second that
leaves room for.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace

import msgspec

from drivers.interfaces import PartError
from drivers.rig.part_check import Finding
from drivers.rig.parts import Rig
from missions.ground import rig_library
from missions.ground.pace import Pace, detector_of
from path.messages import Role

# of what there is, kept free: for frames that take longer, and for all else on the computer
MARGIN = 0.3
# times as long as in a loop of its own a stage takes between all the others (docs/compute.md)
FLOWN = 2.0
# signed messages' worth of work a second: telemetry, setpoints, status, camera, event loop
REST = 3000.0
FEWEST_HZ = 7.0  # with nothing kept free; below, nothing was ever flown
SETPOINT_GAP_S = 0.2  # that is allowed (S8); a setpoint is due so long after the last one:
SETPOINT_S = 0.05
TIMES = 3  # that a share is measured before it is refused
RATES_HZ = (60, 50, 30, 25, 20, 15, 10)
MEASURE_S = 300.0  # the first time everything is compiled
_NAMES = {
    "frame": "copied, depth aligned",
    "pose": "marker's pose",
    "detector": "detector",
    "depth": "depth of the box",
}


def pace_of(
    rig: Rig,
    role: Role,
    *,
    own_only: bool = False,
) -> list[Pace]:
    """Measure in a process of its own, the rig's own size first. Raises PartError when that
    fails.
    """
    command = [
        sys.executable,
        "-m",
        "missions.ground.pace",
        str(rig.file),
        role.value,
        "own" if own_only else "all",
    ]
    try:
        ended = subprocess.run(command, capture_output=True, timeout=MEASURE_S, check=False)
    except subprocess.TimeoutExpired:
        why = f"this computer was not measured within {MEASURE_S:.0f} s"
        raise PartError(why, "run `path-handoff prepare` first") from None
    if ended.returncode != 0:
        last = " ".join(ended.stderr.decode("utf-8", "replace").strip().splitlines()[-1:])
        raise PartError(
            f"this computer was not measured: {last}", "this is a fault of the program: report it"
        )
    return msgspec.json.decode(ended.stdout, type=list[Pace])


def computer_findings(
    rig: Rig,
    role: Role,
    share: float = 1.0,
) -> Iterator[Finding]:
    """Yield each stage's time at the rig's size, and which sizes and rates this computer holds.

    ``share``: of one core, if it were so much slower. Raises PartError.
    """
    paces = pace_of(rig, role)
    own = paces[0]
    where = f"{role.value} computer"
    cores = os.cpu_count() or 1
    load = os.getloadavg()[0]
    if load > cores:
        busy = f"{load:.1f} programs want to run on {cores} cores: what follows is what it could do without them"
        yield Finding("note", f"{where} busy", busy, "end what else runs on it before a flight")
    for name, stage in own.stages.items():
        detail = f"{stage.mean_ms:.2f} ms, 99 of 100 below {stage.p99_ms:.1f} ms"
        yield Finding(
            "ok",
            f"{where} {name}",
            f"{_NAMES.get(name, name)}: {detail}, {own.size[0]}x{own.size[1]}",
        )
    held = ", ".join(
        f"{pace.size[0]}x{pace.size[1]} at {_said(holds_hz(pace, share))}" for pace in paces
    )
    of = "a core" if share == 1.0 else f"{share:g} of a core"
    yield Finding("ok", f"{where} holds", f"{held}; with {100.0 * MARGIN:.0f} % of {of} kept free")
    for each in _judged(rig, role, own, share):
        yield replace(each, name=f"{where} {each.name}")


def holds_hz(
    pace: Pace,
    share: float = 1.0,
    margin: float = MARGIN,
) -> float:
    """Return how many frames of this size a second leave the margin free; 0 when the rest alone
    does not.
    """
    rest = REST * pace.stages["link"].mean_ms * 1e-3
    return max(0.0, ((1.0 - margin) * share - rest) / (FLOWN * pace.frame_ms * 1e-3))


def fits(
    pace: Pace,
    rate_hz: float | None,
    share: float = 1.0,
) -> Finding:
    """Find whether the rig's own size and rate are held; what is missing is given up in flight, or
    is too much.
    """
    name = "rate"
    held_hz = holds_hz(pace, share)
    size = f"{pace.size[0]}x{pace.size[1]}"
    detail = (
        f"{size} at {held_hz:.0f} of {rate_hz:g} frames a second"
        if rate_hz
        else f"{size} at {held_hz:.0f} Hz"
    )
    most_hz = holds_hz(pace, share, margin=0.0)
    if most_hz < FEWEST_HZ:
        fix = f"a faster computer, or smaller images: below {FEWEST_HZ:.0f} frames a second nothing is flown"
        return Finding(
            "fault",
            name,
            f"{detail}, {most_hz:.0f} with nothing kept free: too slow",
            fix,
        )
    if rate_hz is not None and held_hz < rate_hz:
        fix = (
            "a lower frame rate, or smaller images; else pictures and frames are left out in flight"
        )
        return Finding("note", name, detail, fix)
    return Finding("ok", name, detail)


def waits(pace: Pace, share: float = 1.0) -> Finding:
    """Find whether setpoints can wait for a look at the whole image, which nothing interrupts."""
    wait_s = SETPOINT_S + FLOWN * pace.search.p99_ms * 1e-3 / share
    detail = f"up to {wait_s:.2f} s between two, while the whole image is searched; {SETPOINT_GAP_S:g} s are allowed"
    if wait_s > SETPOINT_GAP_S:
        return Finding(
            "fault",
            "setpoints",
            f"{detail}: too slow",
            "a faster computer, or smaller images",
        )
    return Finding("ok", "setpoints", detail)


def refuse_share(rig: Rig, share: float) -> None:
    """Raise PartError, with what was measured, where a share of this core is too little for one of
    the roles.

    Neighbours only make a core slower: a role is refused when it was too slow each of several
    times.
    """
    for role in Role:
        fault = _fault(rig, role, share)
        times = 1
        while fault is not None and times < TIMES:
            fault = _fault(rig, role, share)
            times = times + 1
        if fault is not None:
            what = f"{share:g} of this core is too little for the {role.value}: {fault.name}: {fault.detail}"
            more = f"path-handoff doctor --rig {rig_library.name_of(rig)} --role {role.value} --slow {share:g}"
            raise PartError(what, f"a larger share, or smaller images; `{more}` tells more")


def _fault(
    rig: Rig,
    role: Role,
    share: float,
) -> Finding | None:
    """Return a reason for which a share does not fly this role, measured once at the rig's own
    size.
    """
    (own,) = pace_of(rig, role, own_only=True)
    return next((each for each in _judged(rig, role, own, share) if each.state == "fault"), None)


def _judged(
    rig: Rig,
    role: Role,
    own: Pace,
    share: float,
) -> tuple[Finding, Finding]:
    """Find whether the rig's own size and rate are held, and setpoints kept."""
    found = detector_of(rig.role(role).perception)
    return fits(own, None if found is None else found[1], share), waits(own, share)


def _said(held_hz: float) -> str:
    """The largest usual rate that is held."""
    return next((f"{rate} Hz" for rate in RATES_HZ if rate <= held_hz), "no usual rate")
