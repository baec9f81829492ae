"""docs/faults.md has every end that there is in code, with its code and its meaning, and no
other.
"""

from __future__ import annotations

import re
from pathlib import Path

from flight.command_end import CommandEnd
from flight.outcome import Outcome

PAGE = (Path(__file__).parents[2] / "docs" / "faults.md").read_text("utf-8")
ROW = re.compile(r"^\| (\d+) \| `(\w+)` \| (.+) \|$", re.MULTILINE)


def test_the_page_and_the_code_have_the_same_ends() -> None:
    shown = {
        name: (int(code), re.sub(r"( \(\[.*?\]\(.*?\)\)|:) ?.*$", "", said))
        for code, name, said in ROW.findall(PAGE)
    }
    coded = {
        end.label: (end.exit_code, end.meaning.partition(":")[0]) for end in (*Outcome, *CommandEnd)
    }
    assert shown == coded


def test_no_two_ends_have_one_exit_code_but_the_good_ones() -> None:
    good = (CommandEnd.DONE, Outcome.COMMITTED, Outcome.FLOWN)
    assert [end.exit_code for end in good] == [0, 0, 0]
    codes = [end.exit_code for end in (*Outcome, *CommandEnd) if end not in good]
    assert len({0, *codes}) == len(codes) + 1
