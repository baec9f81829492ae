"""Runs of the machines, as pieces of a campaign and shown one by one."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from missions.ground import rig_library
from missions.ground.rig_library import trial_part
from missions.proofs.campaign.machines import Machines, OpenChannel, ProgramRun
from missions.proofs.campaign.plan import RunPlan, draw
from missions.proofs.campaign.results import RunLine

if TYPE_CHECKING:
    from missions.proofs.campaign.run import RunOrder


def fly(order: RunOrder) -> list[RunLine]:
    channel = _channel(order.rig)
    return [
        _line(level, number, Machines(draw(order.seed, level, number), channel).run())
        for level, number in order.runs
    ]


def replay(order: RunOrder, out: Path | None) -> RunLine:
    """The run's story on the terminal; it has no logs."""
    del out
    (level, number), *_ = order.runs
    plan = draw(order.seed, level, number)
    sys.stdout.write(_story_of(plan))

    def tell(
        time_s: float,
        who: str,
        what: str,
    ) -> None:
        sys.stdout.write(f"{time_s:9.3f} s  {who:<9}{what}\n")

    return _line(level, number, Machines(plan, _channel(order.rig), tell).run())


def _channel(rig: str) -> OpenChannel:
    return trial_part(rig_library.load(rig), "channel")


def _line(
    level: str,
    number: int,
    run: ProgramRun,
) -> RunLine:
    rounded = {name: round(value, 4) for name, value in run.figures.items()}
    return RunLine(number, level, run.outcome, run.violations, run.beyond, rounded, run.broken)


def _story_of(plan: RunPlan) -> str:
    """Return the drawn plan, a line for each field."""
    return "".join(
        f"{field.name}: {getattr(plan, field.name)}\n" for field in dataclasses.fields(plan)
    )
