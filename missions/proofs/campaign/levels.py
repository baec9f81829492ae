"""The named levels of faults, and what each means to either program of the campaign."""

from __future__ import annotations

from missions.ground.options.words import LevelName
from path.values import frozen

Range = tuple[float, float]


@frozen
class MachineLevel:
    """The ranges that a run of the machines is drawn from. Shares and chances are 0..1; ranges are
    uniform.

    Attributes:
        loss, delay_s, jitter_s, duplicate, corrupt, reorder: of the link, as
            ``hil.link.faulty.LinkFaults``.
        outages: how many times at most one or both directions fall silent, for up to ``outage_s``.
        drift_ppm: of either clock against true time, at most.
        step: chance that a clock is set forward or back.
        crash: chance that a program is killed, between any two of its effects; drawn once more for
            a second time.
        stall: chance that a program stands still for a while, between any two of its effects; drawn
            twice.
        forget: chance that a killed program finds an older record when it is started again, or
            none.
        disk_s, late_s: how long at most it takes to write a record down, and how late a program
            wakes.
        forged_hz: forged, altered and repeated packets a second at most, at either end.
        pilot: chance that a pilot, or a guard, ends the mission of one side.
        unable: chance that the receiver does not see the target for a while.
        wrong: chance that an agreement on another object, or of another attempt, is claimed first.
        never: chance that the views never agree.
    """

    loss: Range = (0.0, 0.0)
    delay_s: Range = (0.002, 0.004)
    jitter_s: Range = (0.002, 0.004)
    duplicate: float = 0.0
    corrupt: float = 0.0
    reorder: float = 0.0
    outages: int = 0
    outage_s: float = 0.0
    drift_ppm: float = 20.0
    step: float = 0.0
    crash: float = 0.0
    stall: float = 0.0
    forget: float = 0.0
    disk_s: float = 0.002
    late_s: float = 0.001
    forged_hz: float = 0.0
    pilot: float = 0.0
    unable: float = 0.0
    wrong: float = 0.05
    never: float = 0.02


MACHINE_LEVELS: dict[LevelName, MachineLevel] = {
    "none": MachineLevel(),
    "lossy": MachineLevel(
        loss=(0.1, 0.3), jitter_s=(0.0, 0.05), duplicate=0.1, corrupt=0.02, reorder=0.1, disk_s=0.01, late_s=0.005,
    ),
    "harsh": MachineLevel(
        loss=(0.3, 0.5), delay_s=(0.0, 0.02), jitter_s=(0.0, 0.2), duplicate=0.2, corrupt=0.1, reorder=0.2,
        outages=2, outage_s=3.0, drift_ppm=100.0, crash=0.5, stall=0.3, disk_s=0.04, late_s=0.02, wrong=0.1, never=0.05,
    ),
    "hostile": MachineLevel(
        loss=(0.0, 0.5), delay_s=(0.0, 0.03), jitter_s=(0.0, 0.2), duplicate=0.2, corrupt=0.2, reorder=0.2,
        outages=3, outage_s=3.0, drift_ppm=100.0, step=0.15, crash=0.5, stall=0.3, forget=0.1, disk_s=0.04, late_s=0.02,
        forged_hz=20.0, pilot=0.4, unable=0.3, wrong=0.2, never=0.05,
    ),
}  # fmt: skip
LEVELS: tuple[LevelName, ...] = tuple(MACHINE_LEVELS)
