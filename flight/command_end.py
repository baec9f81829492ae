"""Ends of commands that have no flight's outcome to tell. Exit codes of flights are in
``flight.outcome``.
"""

from __future__ import annotations

from enum import Enum


class CommandEnd(Enum):
    """Named end of a command: (name, exit code, what it means)."""

    DONE = ("done", 0, "what was asked for was done")
    BUG = ("bug", 1, "a traceback: a fault of PATH itself, please report it")
    NOT_UNDERSTOOD = ("not_understood", 2, "the command line was not understood; usage is printed")
    REFUSED = (
        "refused",
        3,
        "refused before anything moved: a rig, a part, a fault, a number, a folder",
    )
    NOT_FIT = ("not_fit", 4, "`doctor`, `plan` or `rigs --check` found a fault")
    GAVE_UP = ("gave_up", 5, "`guard`: a vehicle did not land, whatever it was told")
    OUTPUT_FAILED = (
        "output_failed",
        6,
        "what there was to print or to write could not be: disk full?",
    )
    FAILED = (
        "failed",
        7,
        "`verify`, `trial`, `conformance`: a promise does not hold, or a part of the work failed; "
        "`pose`: no frame has the marker",
    )
    STOPPED = ("stopped", 130, "Ctrl-C, in a command that does not fly")
    READER_GONE = ("reader_gone", 141, "whoever read the output has closed it, as `head` does")

    def __init__(
        self,
        label: str,
        exit_code: int,
        meaning: str,
    ) -> None:
        self.label = label
        self.exit_code = exit_code
        self.meaning = meaning
