"""Runs of both whole role programs in ``sim``: what goes wrong is drawn from level, seed and
number, by its name.
"""

from __future__ import annotations

import random
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.interfaces import PartError
from drivers.rig.parts import Rig, with_errors
from flight.harness.flights import Emit, FlightRequest, Progress
from flight.outcome import Outcome
from missions.fly.handoff.flight import harness_of, judge
from missions.fly.handoff.right_object import fly_watched
from missions.fly.leg.process import fly_role
from missions.ground import rig_library
from missions.ground.options.words import LevelName
from missions.ground.run_folder import claimed
from missions.look.report.records import RUN
from missions.proofs.campaign.plan import seed_of
from missions.proofs.campaign.results import RunLine, story_folder, unread_folder
from path.messages import Role

if TYPE_CHECKING:
    from missions.proofs.campaign.run import RunOrder


PHASES = {
    Role.SENDER: ("acquire", "follow", "verify"),
    Role.RECEIVER: ("stand-off", "search", "approach", "verify", "follow"),
}
DUTIES = {Role.SENDER: ("released", "handed_over"), Role.RECEIVER: ("provisional", "holding")}
CONCERNS = {
    "lookalike": Role.SENDER,
    "marker_hidden": Role.SENDER,
    "depth_holes": Role.SENDER,
    "camera_freeze": Role.RECEIVER,
    "fc_link_loss": Role.RECEIVER,
    "pilot_takeover": Role.RECEIVER,
    "battery_sag": Role.SENDER,
}
"""The faults that the hostile level adds, and whose course says when."""
STALL = 0.3  # chance that a program stands still, drawn twice
# chance, at the hostile level, that a program started again finds an older record, or none
FORGET = 0.3


def draw(
    seed: int,
    level: LevelName,
    number: int,
) -> tuple[int, tuple[str, ...]]:
    """The run's own seed, and its faults as a user would order them."""
    rng = random.Random(seed_of("roles", seed, level, number))
    faults: list[str] = []
    if level == "lossy":
        faults += _link(
            rng,
            loss=(0.1, 0.3),
            jitter_s=0.05,
            duplicate=0.1,
            corrupt=0.02,
            reorder=0.1,
        )
    elif level == "harsh":
        faults += _link(rng, loss=(0.3, 0.5), jitter_s=0.2, duplicate=0.2, corrupt=0.1, reorder=0.2)
    elif level == "hostile":
        faults += _link(
            rng,
            loss=(0.0, 0.3),
            jitter_s=0.05,
            duplicate=0.2,
            corrupt=0.1,
            reorder=0.2,
        )
        faults += [
            f"{name}@{_moment(rng, CONCERNS[name])}"
            for name in rng.sample(sorted(CONCERNS), rng.randint(1, 2))
        ]
    if level in ("harsh", "hostile"):
        for _ in range(rng.randint(0, 2)):
            faults.append(f"link_out={rng.uniform(0.1, 3.0):.2f}@{_moment(rng, Role.SENDER)}")
        if rng.random() < 0.5:
            role = rng.choice(tuple(Role))
            again = f"={rng.uniform(0.1, 6.0):.2f}" if rng.random() < 0.7 else ""
            faults.append(f"kill_{role.value}{again}@{_moment(rng, role)}")
        faults += _stalls(random.Random(seed_of("roles' stalls", seed, level, number)))
    if level == "hostile":
        faults += _disks(random.Random(seed_of("roles' disks", seed, level, number)), faults)
    return rng.getrandbits(31), tuple(faults)


def _stalls(rng: random.Random) -> list[str]:
    """Half of them begin within the lease, those for as long as it may take to sleep over its
    end.
    """
    faults: list[str] = []
    for _ in range(2):
        if rng.random() < STALL:
            role = rng.choice(tuple(Role))
            if rng.random() < 0.5:
                for_s = rng.choice((0.1, 0.39, 2.0))
                moment = f"{DUTIES[role][0]}+{rng.choice((0.0, rng.uniform(0.0, 1.5))):.3f}"
            else:
                for_s = rng.uniform(0.05, 2.0)
                moment = _moment(rng, role)
            faults.append(f"stall_{role.value}={for_s:.2f}@{moment}")
    return faults


def _disks(rng: random.Random, faults: Sequence[str]) -> list[str]:
    """The disks of programs that are killed and started again; from the beginning, so that they are
    in time.
    """
    again = [
        role for role in Role if any(fault.startswith(f"kill_{role.value}=") for fault in faults)
    ]
    return [
        f"disk_{role.value}={rng.choice((1, 2, 100))}@preflight"
        for role in again
        if rng.random() < FORGET
    ]


def _link(
    rng: random.Random,
    loss: tuple[float, float],
    jitter_s: float,
    duplicate: float,
    corrupt: float,
    reorder: float,
) -> list[str]:
    return [
        f"link_loss={rng.uniform(*loss):.3f}",
        f"link_jitter={rng.uniform(0.0, jitter_s):.3f}",
        f"link_duplicate={rng.uniform(0.0, duplicate):.3f}",
        f"link_corrupt={rng.uniform(0.0, corrupt):.3f}",
        f"link_reorder={rng.uniform(0.0, reorder):.3f}",
    ]


def _moment(rng: random.Random, role: Role) -> str:
    """Half of what goes wrong goes wrong within the hand-over itself."""
    if rng.random() < 0.5:
        return f"{rng.choice(DUTIES[role])}+{rng.uniform(0.0, 0.1):.3f}"
    return f"{rng.choice(PHASES[role])}+{rng.uniform(0.0, 8.0):.2f}"


def fly(order: RunOrder) -> list[RunLine]:
    rig = _shorter(order)
    lines: list[RunLine] = []
    for level, number in order.runs:
        with unread_folder() as folder:
            lines.append(_fly(rig, order.seed, level, number, folder, lambda _: None))
    return lines


def replay(order: RunOrder, out: Path | None) -> RunLine:
    """The run's story on the terminal, and its logs in a folder."""
    (level, number), *_ = order.runs
    folder = story_folder(out)
    _, faults = draw(order.seed, level, number)
    sys.stdout.write("".join(f"--fault {fault}\n" for fault in faults))
    line = _fly(_shorter(order), order.seed, level, number, folder, _Story().tell)
    sys.stdout.write(f"logs: {folder}\n")
    return line


class _Story:
    """Phases, responsibility and notes, as they change."""

    def __init__(self) -> None:
        self._last: dict[Role, tuple[object, ...]] = {}

    def tell(self, progress: Progress) -> None:
        what = (progress.phase, progress.responsible, progress.note)
        if self._last.get(progress.role) == what:
            return
        self._last[progress.role] = what
        holds = "responsible" if progress.responsible else ""
        time_s = progress.stamp_ns * 1e-9
        sys.stdout.write(
            f"{time_s:9.3f} s  {progress.role.value:<9}{progress.phase:<10}{holds:<12}{progress.note}\n"
        )


def _shorter(order: RunOrder) -> Rig:
    rig = with_errors(rig_library.load(order.rig), order.errors)
    if rig.level not in ("sim", "sim-rendered"):
        raise PartError(
            f"rig {rig.name} flies in real time", "a campaign of roles wants a rig of level sim"
        )
    return rig_library.shorter(rig)


def _fly(
    rig: Rig,
    seed: int,
    level: LevelName,
    number: int,
    folder: Path,
    emit: Emit,
) -> RunLine:
    own, faults = draw(seed, level, number)
    with claimed(folder, RUN):
        report = fly_watched(
            harness_of(rig), FlightRequest(rig, folder, own, faults, fly_role, _no_process, emit)
        )
    outcome, _ = judge(replace(report, violations={}))
    figures = {**report.figures, "simulated_s": report.simulated_s}
    violations = tuple(note for note in report.notes if note[:1] in "SL" and note[1:2].isdigit())
    rounded = {name: round(value, 4) for name, value in figures.items()}
    name = "commit" if outcome is Outcome.COMMITTED else outcome.label.replace("_", " ")
    return RunLine(
        number,
        level,
        name,
        violations,
        tuple(report.beyond),
        rounded,
        tuple(report.broken),
    )


def _no_process(role: Role) -> Sequence[str]:
    raise AssertionError(f"the {role.value} flies in this process")
