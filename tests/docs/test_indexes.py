"""The indexes of the docs name what there is."""

from __future__ import annotations

import re
from pathlib import Path

DOCS = Path(__file__).parents[2] / "docs"


def test_the_index_of_decisions_has_every_one_by_its_title() -> None:
    index = (DOCS / "decisions" / "README.md").read_text("utf-8")
    listed = re.findall(r"^- \[(\d{4})\]\((\S+)\) (.+)$", index, re.MULTILINE)
    files = sorted((DOCS / "decisions").glob("0*.md"))
    titles = [file.read_text("utf-8").splitlines()[0].removeprefix("# ").strip() for file in files]
    assert listed == [
        (file.name[:4], file.name, title) for file, title in zip(files, titles, strict=True)
    ]


def test_a_decision_keeps_to_a_page() -> None:
    lines = {
        file.name: len(file.read_text("utf-8").splitlines())
        for file in (DOCS / "decisions").glob("0*.md")
    }
    assert {name: count for name, count in lines.items() if count > 50} == {}


def test_what_the_glossary_names_is_there() -> None:
    root = DOCS.parent
    page = (DOCS / "glossary.md").read_text("utf-8")
    named = re.findall(r"`((?:path|drivers|flight|hil|missions)/[\w/.]*)`", page)
    linked = re.findall(r"\]\(([\w/]+\.md)\)", page)
    assert len(named) > 15
    assert [name for name in named if not (root / name).exists()] == []
    assert [name for name in linked if not (DOCS / name).exists()] == []
