"""Trajectories as evo and its like read them (TUM)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

Row = tuple[int, Sequence[float], Sequence[float]]
"""When (ns), where (x y z, m), and which way (quaternion wxyz)."""


def write_tum(path: Path, rows: Sequence[Row]) -> Path:
    """Write a line a row: seconds, x y z in m, quaternion x y z w. Raises OSError."""
    with path.open("w", encoding="utf-8") as file:
        for stamp_ns, (x, y, z), (qw, qx, qy, qz) in rows:
            whole, nanos = divmod(stamp_ns, 1_000_000_000)
            file.write(
                f"{whole}.{nanos:09d} {x:.9f} {y:.9f} {z:.9f} {qx:.9f} {qy:.9f} {qz:.9f} {qw:.9f}\n"
            )
    return path
