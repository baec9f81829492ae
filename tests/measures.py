"""Measure the code by what a reader has to hold: tokens, tokens per line of code, classes,
settings, words of pages.

``python -m tests.measures`` prints a table of the tracked modules outside ``tests``. It judges
nothing.

A token is one of Python's tokenizer, without comments, docstrings, line ends and indentation. A
line of code is one on which such a token begins.
"""

from __future__ import annotations

import ast
import io
import subprocess
import sys
import tokenize
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parent.parent
ROOMS = ("path", "drivers", "flight", "missions", "hil")
# What a newcomer reads first, in this order (docs/tour.md).
READING_PATH = (
    "missions/fly/leg/sender.py",
    "missions/fly/leg/receiver.py",
    "path/cycle/sender.py",
    "path/cycle/receiver.py",
    "path/gate/evidence.py",
    "path/protocol/sender.py",
)
LONG = 100
_SILENT = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENCODING,
    tokenize.ENDMARKER,
}


@dataclass(frozen=True, slots=True)
class Measure:
    """What was counted over some modules."""

    lines: int = 0
    code_lines: int = 0
    tokens: int = 0
    classes: int = 0
    long_lines: int = 0
    comment_lines: int = 0

    def __add__(self, other: Measure) -> Measure:
        return Measure(
            self.lines + other.lines,
            self.code_lines + other.code_lines,
            self.tokens + other.tokens,
            self.classes + other.classes,
            self.long_lines + other.long_lines,
            self.comment_lines + other.comment_lines,
        )

    @property
    def tokens_per_line(self) -> float:
        """Return the mean number of tokens on a line of code; 0 without any."""
        return self.tokens / self.code_lines if self.code_lines else 0.0


def measure(source: str) -> Measure:
    """Count one module. Raises SyntaxError for what is no Python."""
    tree = ast.parse(source)
    silent_lines = _docstring_lines(tree)
    spoken: list[int] = []
    comments: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        line = token.start[0]
        if token.type == tokenize.COMMENT:
            comments.add(line)
        is_docstring = token.type == tokenize.STRING and line in silent_lines
        if token.type not in _SILENT and not is_docstring:
            spoken.append(line)
    lines = source.splitlines()
    return Measure(
        lines=len(lines),
        code_lines=len(set(spoken)),
        tokens=len(spoken),
        classes=sum(isinstance(node, ast.ClassDef) for node in ast.walk(tree)),
        long_lines=sum(len(line) > LONG for line in lines),
        comment_lines=len(comments),
    )


def _docstring_lines(tree: ast.Module) -> set[int]:
    """Return the lines on which docstrings begin."""
    found: set[int] = set()
    for node in ast.walk(tree):
        if not isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        first = node.body[0] if node.body else None
        if not (isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant)):
            continue
        if isinstance(first.value.value, str):
            found.add(first.lineno)
    return found


def total(files: Iterable[Path]) -> Measure:
    """Add up the measures of some modules."""
    return sum((measure(file.read_text("utf-8")) for file in files), Measure())


def tracked(pattern: str) -> list[Path]:
    """Return the tracked files that match a pattern of git's, without what a program wrote."""
    listed = subprocess.run(
        ("git", "ls-files", "--", pattern), cwd=ROOT, check=True, capture_output=True, text=True
    )
    files = [ROOT / name for name in listed.stdout.splitlines()]
    return [file for file in files if file.exists()]


def words(files: Iterable[Path]) -> int:
    """Count the words of some pages."""
    return sum(len(file.read_text("utf-8").split()) for file in files)


def main() -> int:
    """Print the table."""
    head = f"{'':<14}{'tokens':>9}{'a line':>8}{'code lines':>12}{'classes':>9}{'> 100':>8}{'comments':>10}\n"
    sys.stdout.write(head)
    rows = {room: total(tracked(f"{room}/*.py")) for room in ROOMS}
    rows["all"] = sum(rows.values(), Measure())
    rows["reading path"] = total(ROOT / name for name in READING_PATH)
    for name, found in rows.items():
        long_share = 100.0 * found.long_lines / found.lines
        comments = 100.0 * found.comment_lines / found.lines
        sys.stdout.write(
            f"{name:<14}{found.tokens:>9,}{found.tokens_per_line:>8.2f}{found.code_lines:>12,}"
            f"{found.classes:>9,}{long_share:>7.1f}%{comments:>9.1f}%\n"
        )
    decisions = tracked("docs/decisions/*.md")
    # What is in tables/ is written into pages, and counted there.
    pages = [page for page in tracked("docs/*.md") if page.parent.name != "tables"]
    readme = words([ROOT / "README.md"])
    sys.stdout.write(
        f"README {readme:,} words, pages {words(pages):,} in all,"
        f" {len(decisions)} decisions {words(decisions):,}\n"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
