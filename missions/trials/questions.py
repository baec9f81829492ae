"""The questions that ``path-handoff trial`` asks, and the experiments that answer each.

An experiment is a module ``trial`` in the folder of its question, with

- ``TITLE``: one line; ``PAPER``: the section of the paper it reproduces, "" when there is none;
- ``run(request) -> TrialResult``;
- ``NEEDS``, when it needs any: what the rig's ``[trials]`` table must name;
- ``check(rig)``, when it needs more of a rig: raises PartError.

What it needs is looked for before anything is flown.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from path.values import frozen

Option = Literal["xfeat", "set", "logs", "seconds", "method", "common_view"]
RIG = "sim-rendered"
"""The rig whose harness knows the truth: ``--rig`` takes its place."""


@frozen
class Experiment:
    """One experiment.

    Attributes:
        package: where its module ``trial`` is, below ``missions.trials``.
        rig: flown when none is named.
        options: of the command that it takes.
        without: what is left out when its file is not named, by option.
        short_in_all: ``trial all`` runs its short form: whole it would take longer than all others.
    """

    package: str
    rig: str = RIG
    options: tuple[Option, ...] = ()
    without: str = ""
    short_in_all: bool = False

    @property
    def module(self) -> str:
        return f"missions.trials.{self.package}.trial"


XFEAT = "XFeat, whose weights --xfeat names"
SETS = "all of it: photographs, which --set names"
SEQUENCE = "all of it: an RGB-D sequence, which --common-view names"

EXPERIMENTS: Mapping[str, Experiment] = {
    "sensitivity": Experiment("pose.sensitivity"),
    "static": Experiment("pose.static"),
    "corners": Experiment("pose.corners"),
    "calibration": Experiment("pose.calibration"),
    "real": Experiment("real", options=("set",), without=SETS),
    "common-view": Experiment("pose.common_view", options=("common_view",), without=SEQUENCE),
    "handshake": Experiment("handovers.handshake"),
    "evidence": Experiment("handovers.evidence"),
    "recall": Experiment("handovers.recall", short_in_all=True),
    "dynamic": Experiment("flights.dynamic"),
    "beacon": Experiment(
        "flights.beacon",
        "dynamic",
        options=("logs", "seconds"),
        short_in_all=True,
    ),
    "wash": Experiment("flights.wash", "sim", short_in_all=True),
    "obstacles": Experiment("flights.obstacles", "sim", short_in_all=True),
    "ambiguity": Experiment("rivals", options=("xfeat", "method"), without=XFEAT),
    "link": Experiment("cost.link"),
    "compute": Experiment("cost.compute", options=("xfeat",), without=XFEAT),
    "soak": Experiment("cost.soak", "sitl", options=("seconds",), short_in_all=True),
}
QUESTIONS: Mapping[str, tuple[str, ...]] = {
    "pose": ("sensitivity", "static", "corners", "calibration", "real", "common-view"),
    "handovers": ("handshake", "evidence", "recall"),
    "flights": ("dynamic", "beacon", "wash", "obstacles"),
    "rivals": ("ambiguity",),
    "cost": ("link", "compute", "soak"),
}


def question_of(name: str) -> str:
    """Return the question that an experiment belongs to."""
    return next(question for question, names in QUESTIONS.items() if name in names)


def is_experiment(name: str) -> bool:
    """Return whether this is the name of one experiment, and of no question."""
    return name in EXPERIMENTS
