"""The figures of the pages: kept of runs, quoted by tables, written into pages
(docs/figures/README.md).
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
QUOTE = re.compile(r"\{([\w/-]+): ([^{},]+)(?:, ([^{}]+))?\}")
BLOCK = re.compile(r"(<!-- figures: ([\w-]+) -->\n).*?(<!-- end of figures -->)", re.DOTALL)
DIFFERS = re.compile(r" --(?:seeds?|runs|jobs|out) \S+")  # from one run to the next
OF_ALL = ("command", "commit")


class FigureError(Exception):
    """A figure that cannot be kept or shown; the text says why."""


@dataclass(frozen=True, slots=True)
class KeptFigures:
    """What one command gave, by the path in its ``summary.json``; no commit and no values until it
    was run.
    """

    command: str
    commit: str = ""
    values: Mapping[str, Any] = field(default_factory=dict[str, Any])


@dataclass(frozen=True, slots=True)
class FigureFolder:
    """The pages, and in ``figures`` beside them what is kept and the tables that quote it."""

    docs: Path

    def pages(self) -> list[Path]:
        return [*self.docs.parent.glob("README.md"), *sorted(self.docs.glob("*.md"))]

    def names(self, of: str = "kept") -> list[str]:
        folder = self.docs / "figures" / of
        return sorted(
            file.relative_to(folder).with_suffix("").as_posix() for file in folder.rglob("*.*")
        )

    def kept(self, name: str) -> KeptFigures:
        return KeptFigures(**json.loads(_text(self.docs / "figures" / "kept" / f"{name}.json")))

    def table(self, name: str) -> str:
        return _text(self.docs / "figures" / "tables" / f"{name}.md")

    def quotes(self) -> Iterator[tuple[str, str]]:
        """Yields what is kept and a path in it, for all that tables quote."""
        for table in self.names("tables"):
            for name, path, _ in QUOTE.findall(self.table(table)):
                yield name, path

    def render(self, table: str) -> str:
        def told(quote: re.Match[str]) -> str:
            kept = self.kept(quote[1])
            said = {"command": kept.command, "commit": kept.commit or "not run yet"}
            return said.get(quote[2]) or as_text(kept.values.get(quote[2]), quote[3] or "")

        return QUOTE.sub(told, self.table(table))

    def written(self, page: str) -> str:
        """Returns a page with all its tables as they are now."""
        return BLOCK.sub(lambda block: f"{block[1]}{self.render(block[2])}{block[3]}", page)

    def keep(self, name: str, summary: Mapping[str, Any], commit: str) -> None:
        """Keeps what tables quote of a summary. Raises FigureError for another command's, or a
        short run's.
        """
        before = self.kept(name).command
        command = str(summary.get("command") or _as_run(before, summary))
        if _asked(command) != _asked(before):
            raise FigureError(f"{name} is of `{before}`, and this of `{command}`")
        if any(summary.get(key) for key in ("quick", "short", "unfinished")):
            raise FigureError("a short or unfinished run gives no figures")
        wanted = sorted({path for kept, path in self.quotes() if kept == name} - {*OF_ALL})
        now = KeptFigures(command, commit, {path: value_at(summary, path) for path in wanted})
        file = self.docs / "figures" / "kept" / f"{name}.json"
        file.write_text(json.dumps(asdict(now), indent=2, ensure_ascii=False) + "\n", "utf-8")

    def write(self) -> None:
        for page in self.pages():
            page.write_text(self.written(_text(page)), "utf-8")


def _asked(command: str) -> str:
    """Return what a command asks: without what differs, and by an experiment's own name as it was
    once called.
    """
    return re.sub(r"trial \w+ --only ", "trial ", DIFFERS.sub("", command))


def _as_run(command: str, summary: Mapping[str, Any]) -> str:
    """Returns the command with what a summary that names none says of it."""
    for key in ("rig", "seed", "runs", "hours", "drones"):
        command = re.sub(rf"--{key} \S+", f"--{key} {as_text(summary.get(key), 'g')}", command)
    return command


def _text(file: Path) -> str:
    if not file.exists():
        raise FigureError(f"no {file.parent.name}/{file.name}")
    return file.read_text("utf-8")


def value_at(summary: Any, path: str) -> Any:
    """Returns what is at ``a.b[key=value key=value].c``; raises FigureError where nothing is."""
    here = summary
    for part in re.findall(r"[^.\[\]]+|\[[^\]]*\]", path):
        try:
            if part.startswith("["):
                wanted = dict(pair.split("=", 1) for pair in part[1:-1].split(" "))
                (here,) = [
                    each
                    for each in here
                    if all(as_text(each[key], "") == said for key, said in wanted.items())
                ]
            else:
                here = here[part]
        except (KeyError, TypeError, ValueError) as error:
            raise FigureError(f"no {part} of {path} in that summary") from error
    return here


def as_text(value: Any, form: str) -> str:
    """Returns a value as a page shows it: ``form`` is one of those of docs/figures/README.md."""
    if value is None:
        return "| – | | | | | |" if form == "findings" else "–"
    if form == "counts":
        return (
            ", ".join(f"{count} `{what}`" for what, count in value.items() if what != "committed")
            or "none"
        )
    if form == "findings":
        said = {"met": "met", "short": "falls short", "measured": ""}
        row = "| {quantity} | {ours} | {interval} | {paper} | {goal} |"
        return "\n".join(
            f"{row.format(**finding)} {said[finding['verdict']]} |" for finding in value
        )
    if isinstance(value, list):
        return " to ".join(as_text(end, form) for end in value)
    if isinstance(value, str):
        return value
    times, _, plain = form.rpartition(" * ")
    return format(value * int(times or 1), plain or (",d" if isinstance(value, int) else "g"))


def _git(*words: str) -> str:
    return subprocess.run(
        ("git", *words), cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout.strip()


def main(folder: FigureFolder, words: list[str]) -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.docs.figures", description=__doc__)
    parser.add_argument(
        "does", choices=("list", "write", "keep"), help="keep: a run's figures, and write the pages"
    )
    parser.add_argument("name", nargs="?", help="what they are kept as")
    parser.add_argument("run", nargs="?", type=Path, help="the run's folder")
    parser.add_argument(
        "--commit", help="of the code that was run; the one that is checked out when left out"
    )
    asked = parser.parse_args(words)
    try:
        if asked.does == "list":
            for name in folder.names():
                kept = folder.kept(name)
                sys.stdout.write(f"{name:<30}{kept.commit or 'not run yet':<13}{kept.command}\n")
            return 0
        if asked.does == "keep":
            if not asked.commit and _git("status", "--porcelain", "--", "*.py", "*.toml"):
                raise FigureError(
                    "the code here is not what was committed: commit it, or say --commit"
                )
            commit = asked.commit or _git("rev-parse", "--short=8", "HEAD")
            folder.keep(asked.name, json.loads(_text(asked.run / "summary.json")), commit)
        folder.write()
    except FigureError as error:
        sys.stderr.write(f"error: {error}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(FigureFolder(ROOT / "docs"), sys.argv[1:]))
