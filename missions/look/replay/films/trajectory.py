"""A drone's poses while it filmed: a trajectory as evo and its like write it, or nothing but that
it hung level.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from drivers.interfaces import PartError
from drivers.text_file import MOST_BYTES, read_file
from flight.guidance import add, scale, subtract
from path.geometry.rotation import IDENTITY, normalized, slerp
from path.messages import Quat, Vec3
from path.values import frozen

NS = 1_000_000_000
# positions of GPS are rough from one to the next, and the marker's filter goes by velocities
SLOPE_NS = 600_000_000
REMEDY = "lines are: seconds, x y z in m (north, east, down), quaternion x y z w of the body (forward, right, down)"


@frozen
class BodyState:
    """A drone at an instant: north, east, down in m and m/s, and the attitude of its body."""

    position_n_m: Vec3
    velocity_n_mps: Vec3
    q_n_b: Quat


HANGING = BodyState((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), IDENTITY)
"""One of which nothing is known: level, in one place, its heading is north."""


class FlownPath:
    """Positions and attitudes by stamps, ns, that increase; what is between two of them is
    interpolated.
    """

    def __init__(
        self,
        stamps: Sequence[int],
        positions: Sequence[Vec3],
        attitudes: Sequence[Quat],
    ) -> None:
        self._stamps = stamps
        self._positions = positions
        self._attitudes = attitudes

    def covers(self, begin_ns: int, end_ns: int) -> bool:
        return self._stamps[0] <= begin_ns and end_ns <= self._stamps[-1]

    @property
    def span(self) -> str:
        return f"{self._stamps[0] / NS:.3f} s to {self._stamps[-1] / NS:.3f} s"

    def at(self, stamp_ns: int) -> BodyState:
        """The drone at a stamp that it covers; its velocity is that of ``SLOPE_NS`` around it."""
        k, share = self._between(stamp_ns)
        begin_ns = max(stamp_ns - SLOPE_NS // 2, self._stamps[0])
        end_ns = min(stamp_ns + SLOPE_NS // 2, self._stamps[-1])
        moved = subtract(self._place(end_ns), self._place(begin_ns))
        q = slerp(self._attitudes[k - 1], self._attitudes[k], share)
        return BodyState(self._place(stamp_ns), scale(moved, NS / (end_ns - begin_ns)), q)

    def _place(self, stamp_ns: int) -> Vec3:
        k, share = self._between(stamp_ns)
        before = self._positions[k - 1]
        return add(before, scale(subtract(self._positions[k], before), share))

    def _between(self, stamp_ns: int) -> tuple[int, float]:
        """The pose after a stamp, and how much of the way to it has passed since the one before."""
        k = min(max(bisect_right(self._stamps, stamp_ns), 1), len(self._stamps) - 1)
        before_ns = self._stamps[k - 1]
        after_ns = self._stamps[k]
        return k, min(1.0, max(0.0, (stamp_ns - before_ns) / (after_ns - before_ns)))


def read_flown_path(file: Path, offset_ns: int) -> FlownPath:
    """A TUM file, its stamps moved by an offset. Raises PartError naming the line that is none."""
    try:
        lines = read_file(file, 64 * MOST_BYTES).decode("utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise PartError(f"{file}: {getattr(error, 'strerror', None) or error}", REMEDY) from error
    stamps: list[int] = []
    positions: list[Vec3] = []
    attitudes: list[Quat] = []
    for number, line in enumerate(lines, 1):
        text = line.partition("#")[0].split()
        if not text:
            continue
        try:
            seconds, x, y, z, qx, qy, qz, qw = map(float, text)
            q = normalized((qw, qx, qy, qz))
            stamp_ns = round(seconds * NS) + offset_ns
            if not math.isfinite(x + y + z):
                raise ValueError
        except (ValueError, OverflowError) as error:
            raise PartError(
                f"{file}: line {number}: {line.strip()!r} is no pose", REMEDY
            ) from error
        stamps.append(stamp_ns)
        positions.append((x, y, z))
        attitudes.append(q)
    if len(stamps) < 2 or any(after <= before for before, after in pairwise(stamps)):
        raise PartError(
            f"{file}: fewer than two poses, or not in the order of their stamps", REMEDY
        )
    return FlownPath(stamps, positions, attitudes)
