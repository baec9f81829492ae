"""Memory and the age of frames over a soak."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from drivers.log.mcap_log import LogRecord
from missions.look.report.palette import DIM, ROLE
from missions.trials.cost.soak.watch import ProgramSample
from missions.trials.shared.drawing import panels, save
from path.messages import Role

_BLOCK_S = 5.0


def draw(
    samples: Mapping[str, Sequence[ProgramSample]],
    frames: Mapping[Role, Sequence[LogRecord]],
    path: Path,
) -> None:
    """Raise OSError when it cannot be written."""
    figure, (left, right) = panels(11.0, 4.2, columns=2)
    begin_s = min(taken[0].time_s for taken in samples.values())
    for name, taken in samples.items():
        role = next((role for role in Role if role.value == name), None)
        color, width = (ROLE[role], 1.6) if role else (None, 0.8)
        minutes = [(one.time_s - begin_s) / 60.0 for one in taken]
        left.plot(minutes, [one.private_mib for one in taken], label=name, color=color, lw=width)
    left.set(xlabel="min", ylabel="memory of its own, MiB", ylim=(0.0, None))
    left.legend(fontsize=8, frameon=False)
    for role, seen in frames.items():
        _ages(right, role, seen)
    right.set(xlabel="min", ylabel="age of a frame at its cycle, ms", ylim=(0.0, None))
    right.legend(fontsize=8, frameon=False)
    for axes in (left, right):
        axes.grid(alpha=0.3, color=DIM)
    save(figure, path)


def _ages(axes: Axes, role: Role, frames: Sequence[LogRecord]) -> None:
    """Median and 95th percentile of blocks of a few seconds."""
    if not frames:
        return
    seconds = np.array([(frame.stamp_ns - frames[0].stamp_ns) * 1e-9 for frame in frames])
    ages = np.array([frame.record["age_ns"] * 1e-6 for frame in frames])
    blocks = (seconds // _BLOCK_S).astype(int)
    kept = np.unique(blocks)
    minutes = (kept + 0.5) * _BLOCK_S / 60.0
    for q, style in ((50, "-"), (95, ":")):
        line = [float(np.percentile(ages[blocks == block], q)) for block in kept]
        axes.plot(minutes, line, style, color=ROLE[role], lw=1.2, label=f"{role.value}, {q} %")
