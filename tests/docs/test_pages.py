"""The README and the pages: their links, the files they name, and their commands."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from missions import cli

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
STANDS_FOR = {"ROLE": "sender", "LEVEL": "careful"}
UNDERSTOOD = 150


def named(pattern: str) -> Iterator[tuple[Path, Any]]:
    for page in (*PAGES, *(ROOT / "docs" / "decisions").glob("*.md")):
        for found in re.findall(pattern, page.read_text("utf-8")):
            yield page, found


def test_no_link_is_dead() -> None:
    links = [(page, link) for page, link in named(r"\]\(([^)\s#]+)") if not link.startswith("http")]
    assert len(links) > 200
    assert [(page.name, link) for page, link in links if not (page.parent / link).exists()] == []


def test_every_heading_that_a_link_names_is_there() -> None:
    links = list(named(r"\]\(([\w./-]*\.md)#([\w-]+)\)"))
    assert len(links) > 20
    assert [
        (page.name, link) for page, link in links if link[1] not in anchors(page.parent / link[0])
    ] == []


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.+)$", page.read_text("utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading).lower().replace(" ", "-") for heading in headings}


def test_the_tests_that_pages_name_are_there() -> None:
    tests = list(
        named(
            r"`(?:tests/)?((?:contracts|drivers|flight|hil|missions|path|scenarios)/[\w/]*test_\w+\.py)`"
        )
    )
    assert len(tests) > 3
    assert [(page.name, test) for page, test in tests if not (ROOT / "tests" / test).exists()] == []


def test_the_pages_that_code_names_are_there() -> None:
    modules = [
        file
        for room in ("path", "drivers", "flight", "missions", "hil", "tests", "install")
        for file in (ROOT / room).rglob("*.*")
        if file.suffix in (".py", ".toml", ".sh")
    ]
    pages = [
        (file.name, page)
        for file in modules
        for page in re.findall(r"docs/[\w/-]+\.md\b", file.read_text("utf-8"))
    ]
    numbers = {file.name[:4] for file in (ROOT / "docs" / "decisions").glob("0*.md")}
    records = [
        (file.name, number)
        for file in modules
        for number in re.findall(r"docs/decisions/(0\d{3})", file.read_text("utf-8"))
    ]
    assert len(pages) > 40
    assert [(name, page) for name, page in pages if not (ROOT / page).exists()] == []
    assert [(name, number) for name, number in records if number not in numbers] == []


def commands() -> Iterator[tuple[str, str]]:
    """Yields page and command; of a line of the shell the first one, without placeholders for what
    is left out.
    """
    for page in PAGES:
        text = page.read_text("utf-8")
        blocks = re.findall(r"```(?:sh|bash)?\n(.*?)```", text, re.DOTALL)
        lines = [
            line.strip() for block in blocks for line in block.replace("\\\n", " ").splitlines()
        ]
        for line in (*lines, *re.findall(r"`(path-handoff [^`]+)`", text)):
            whole = re.fullmatch(
                r"(?:\.venv/bin/)?path-handoff (.*?)(?:\s#.*|\s&.*|\s\|.*|;.*|\s>\s.*)?", line
            )
            if whole is not None and "..." not in line and "…" not in line:
                yield page.name, whole[1]


def test_every_command_is_understood(capsys: pytest.CaptureFixture[str]) -> None:
    wrong: list[str] = []
    asked = sorted({command: page for page, command in commands()}.items())
    for command, page in asked:
        words = [
            STANDS_FOR.get(word, "3" if word in ("N", "M", "K") else word)
            for word in shlex.split(command)
        ]
        if words[0] in ("sender", "receiver") and "--rig" not in words:
            words += ["--rig", "RIG"]
        try:
            cli._understood(cli._spelled_out(words))
        except SystemExit as end:
            wrong += [f"{page}: {command}"] if end.code else []
    assert len(asked) > UNDERSTOOD
    assert wrong == []
