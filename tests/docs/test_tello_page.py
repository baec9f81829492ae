"""The page's table of what the emulated Tello answers, and the emulated Tello."""

from __future__ import annotations

import itertools
import re
from collections.abc import Generator
from pathlib import Path

import pytest

from hil.tello.emulator import TelloEmulator, TelloEmulatorConfig
from hil.world.config import WorldConfig
from hil.world.world import World
from path.messages import Role

PAGE = (Path(__file__).parent.parent.parent / "docs" / "tello.md").read_text("utf-8")
TABLE = PAGE.split("## What the emulated one answers")[1].split("\n## ")[0]
ROWS = [row.strip("| ").split(" | ", 1) for row in TABLE.splitlines() if row.startswith("| `")]
NAMED = [re.findall(r"`([^`]+)`", named) for named, _ in ROWS]
KNOWN, REFUSED = set(itertools.chain(*NAMED[:-1])), set(NAMED[-1])


@pytest.fixture(scope="module")
def emulator() -> Generator[TelloEmulator]:
    made = TelloEmulator(
        TelloEmulatorConfig("127.0.80.1"), World(WorldConfig(), seed=1).drone(Role.SENDER)
    )
    yield made
    made.close()


def test_the_table_has_every_command_that_is_known_and_no_other(emulator: TelloEmulator) -> None:
    assert emulator.words | set(emulator.queries()) == KNOWN


def test_what_the_table_says_is_refused_is_refused(emulator: TelloEmulator) -> None:
    assert "unknown command" in ROWS[-1][1]
    for word in REFUSED:
        assert emulator._execute(word, []) == f"unknown command: {word}"


def test_settings_are_answered_as_the_table_says(emulator: TelloEmulator) -> None:
    asked = {
        "mon": [],
        "moff": [],
        "mdirection": ["2"],
        "setresolution": ["low"],
        "setbitrate": ["1"],
        "downvision": ["1"],
    }
    said = {word: answer for named, (_, answer) in zip(NAMED, ROWS, strict=True) for word in named}
    for word, arguments in asked.items():
        assert said[word].startswith("`ok`")
        assert emulator._execute(word, arguments) == "ok"
    for word, arguments in (
        ("go", ["50", "0", "0", "30", "m1"]),
        ("jump", ["50", "0", "80", "30", "0", "m1", "m2"]),
    ):
        assert emulator._execute(word, arguments) == "error No valid marker"
    assert "`error No valid marker`" in said["jump"]
