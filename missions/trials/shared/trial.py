"""The request to a trial, and what it gives back: a summary, findings, tables and figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field
from pathlib import Path
from typing import Any, Literal

from drivers.rig.parts import Rig
from missions.ground.rig_library import trial_part
from missions.ground.work import Work
from path.values import frozen

Verdict = Literal["met", "short", "measured"]


@frozen
class TrialRequest:
    """One trial to run.

    Attributes:
        rig: names the renderer and the other parts that know the truth (``[trials]``).
        out: folder of this trial; it exists.
        seed: of every random number.
        quick: a short form: the same code on few samples, for tests.
        work: runs pieces on all cores, and shows how far they are.
        xfeat: weights of XFeat (ONNX), None when not named.
        logs: folder of a session to be judged instead of flying one, None when not named.
        seconds: how long to record where nothing is flown; 0: until Ctrl-C.
        sets: TOML files that describe sets of photographs. ``photographs``: what their paths are
            relative to, None for each file's own folder.
        method: one of somebody's own that takes part, ``file.py:Name``.
        common_view: folder of an RGB-D sequence with poses, None when not named.
    """

    rig: Rig
    out: Path
    seed: int
    quick: bool
    work: Work
    xfeat: Path | None = None
    logs: Path | None = None
    seconds: float = 0.0
    sets: tuple[Path, ...] = ()
    photographs: Path | None = None
    method: str | None = None
    common_view: Path | None = None

    def part(self, name: str) -> Any:
        """The class or function that the rig's ``[trials]`` table names. Raises PartError when it
        names none.
        """
        return trial_part(self.rig, name)


@frozen
class TrialFinding:
    """One number held against the paper's or against a goal, as the reader sees it.

    Attributes:
        quantity: what it is, with its unit.
        ours, interval: as text; ``interval`` is a 95 % interval, or says what else it is.
        paper: the paper's figure, "" when it has none.
        goal: what is to be reached, "" when there is no goal.
        verdict: "met" or "short" of the goal; "measured" when there is none.
        note: why it falls short, or what to know to read it.
    """

    quantity: str
    ours: str
    interval: str = ""
    paper: str = ""
    goal: str = ""
    verdict: Verdict = "measured"
    note: str = ""


@frozen
class TrialTable:
    """A table of the report: texts, the first column names the row."""

    title: str
    columns: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]
    note: str = ""


@frozen
class TrialResult:
    """The result of a trial.

    Attributes:
        summary: for ``summary.json``: plain numbers in SI units, names with unit suffixes.
        pictures: PNGs in the trial's folder, each with its caption.
        noise: the table of the noise model and every systematic error that was switched on.
        notes: what a reader has to know: where simulation ends, what was left out and why.
        violations: of whole missions that were flown, by monitor.
    """

    summary: Mapping[str, Any]
    findings: Sequence[TrialFinding]
    noise: TrialTable | None = None
    tables: Sequence[TrialTable] = ()
    pictures: Mapping[str, str] = field(default_factory=dict[str, str])
    notes: Sequence[str] = ()
    violations: Mapping[str, int] = field(default_factory=dict[str, int])


def verdict(reached: bool) -> Verdict:
    return "met" if reached else "short"
