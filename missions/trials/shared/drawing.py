"""Figures of trials: the sheet, panels on it, and how it is written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

DPI = 110


def sheet(width_in: float, height_in: float) -> Figure:
    """Return an empty figure."""
    return Figure(figsize=(width_in, height_in), dpi=DPI, layout="constrained")


def panels(
    width_in: float,
    height_in: float,
    columns: int = 1,
) -> tuple[Figure, list[Axes]]:
    """Return a figure of panels side by side."""
    figure = sheet(width_in, height_in)
    return figure, list(np.ravel(figure.subplots(1, columns, squeeze=False)))


def save(figure: Figure, file: Path) -> None:
    """Write a figure: the same one gives the same bytes. Raises OSError."""
    figure.savefig(file, format="png", metadata={"Software": None})
