"""The words of the code: one meaning for a class name, and docstrings that say what a thing is or does."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parent.parent
SOURCES = {
    str(file.relative_to(ROOT)): file.read_text("utf-8")
    for package in ("path", "drivers", "flight", "missions", "hil")
    for file in sorted((ROOT / package).rglob("*.py"))
    if file.name != "path_dialect.py"
}
SHARED: set[str] = set()  # the class names that stand for two things; at most ten


def test_a_class_name_means_one_thing() -> None:
    named = Counter(name for text in SOURCES.values() for name in re.findall(r"^class (\w+)", text, re.MULTILINE))
    assert len(named) > 900
    assert {name for name, times in named.items() if times > 1} == SHARED


def test_a_docstring_opens_with_the_thing() -> None:
    opening = re.compile(r'^ *"""(?:What|How|Where|When|Why|Which|Who)\b.*', re.MULTILINE)
    assert [f"{file}: {found}" for file, text in SOURCES.items() for found in opening.findall(text)] == []
