"""The figures of the pages: kept of runs, quoted by tables, written into pages
(docs/figures/README.md).
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import json
import re
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
QUOTE = re.compile(r"\{([\w/-]+): ([^{},]+)(?:, ([^{}]+))?\}")
BLOCK = re.compile(r"(<!-- figures: ([\w-]+) -->\n).*?(<!-- end of figures -->)", re.DOTALL)
DIFFERS = re.compile(r" --(?:seeds?|runs|jobs|out) \S+")  # from one run to the next
OF_ALL = ("command", "commit")
# What tables may write in place of a series of flights: `flights:` a head, `flights: NAME` a row.
FLIGHT_HEAD = (
    "| command | handed over (95 %) | agreement, median and 95 % | D2, mm | target, mm "
    "| wrong objects; violations | ended otherwise | commit |\n|---|---|---|---|---|---|---|---|"
)
FLIGHT_ROW = (
    "| `{NAME: command}` "
    "| {NAME: commit_rate, 100 * .0f} % of {NAME: runs} ({NAME: commit_rate_interval, 100 * .1f}) "
    "| {NAME: agreement_s.median, .1f} and {NAME: agreement_s.p95, .1f} s "
    "| {NAME: d2_error_m.median, 1000 * .1f} | {NAME: target_error_m.median, 1000 * .0f} "
    "| {NAME: wrong_handovers}; {NAME: monitors, counts} "
    "| {NAME: outcomes, counts} | {NAME: commit} |"
)


class FigureError(Exception):
    """A figure that cannot be kept or shown; the text says why."""


# What a figure rests on: of single frames, and of all else.
FRAMES = ("path", "hil", "missions/trials")
FLIGHTS = (*FRAMES, "drivers", "flight", "missions/fly", "missions/ground", "missions/proofs")
OF_FRAMES = ("static", "corners", "calibration", "real", "ambiguity", "compute", "evidence")
MINUTES = 90.0  # on two cores, for all of them


@dataclass(frozen=True, slots=True)
class KeptFigures:
    """What one command gave, by the path in its ``summary.json``; no commit and no values until it
    was run. ``code`` is the digest of what it rests on, empty when nobody knows.
    """

    command: str
    commit: str = ""
    code: str = ""
    took_s: float = 0.0
    values: Mapping[str, Any] = field(default_factory=dict[str, Any])

    @property
    def is_old(self) -> bool:
        """Whether the code that it rests on is another one by now."""
        return bool(self.commit) and self.code != code_digest(rests_on(self.command))

    @property
    def origin(self) -> str:
        """Return the commit as pages show it."""
        if not self.commit:
            return "not run yet"
        return f"{self.commit}, older code" if self.is_old else self.commit


def rests_on(command: str) -> tuple[str, ...]:
    """Return the folders that a command's figures rest on."""
    of_frames = " trial " in command and any(name in command.split() for name in OF_FRAMES)
    return FRAMES if of_frames else FLIGHTS


@cache
def code_digest(folders: tuple[str, ...]) -> str:
    """Return a digest of some folders' code and rigs, without comments, docstrings and layout."""
    digest = hashlib.sha256()
    for folder in folders:
        for file in sorted((ROOT / folder).rglob("*")):
            if file.suffix in (".py", ".toml") and file.name != "path_dialect.py":
                text = file.read_text("utf-8")
                spoken = code_of(text) if file.suffix == ".py" else text
                digest.update(f"{file.relative_to(ROOT).as_posix()}\n{spoken}\n".encode())
    return digest.hexdigest()[:16]


def code_of(source: str) -> str:
    """Return a module's text without lines of comments, docstrings, spaces and line ends."""
    lines = source.splitlines()
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        if ast.get_docstring(node, clean=False) is None:
            continue
        first = node.body[0]
        for line in range(first.lineno - 1, first.end_lineno or first.lineno):
            lines[line] = ""
    code = (line for line in lines if not line.lstrip().startswith("#"))
    return "".join("".join(code).split())


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
        """Return a table with its quotes; ``flights: NAME`` is a row of quotes, after a head."""
        text = _text(self.docs / "figures" / "tables" / f"{name}.md")
        text = text.replace("flights:\n", f"{FLIGHT_HEAD}\n")
        return re.sub(r"flights: (\S+)", lambda row: FLIGHT_ROW.replace("NAME", row[1]), text)

    def quotes(self) -> Iterator[tuple[str, str]]:
        """Yields what is kept and a path in it, for all that tables quote."""
        for table in self.names("tables"):
            for name, path, _ in QUOTE.findall(self.table(table)):
                yield name, path

    def render(self, table: str) -> str:
        def told(quote: re.Match[str]) -> str:
            kept = self.kept(quote[1])
            said = {"command": kept.command, "commit": kept.origin}
            return said.get(quote[2]) or as_text(kept.values.get(quote[2]), quote[3] or "")

        return QUOTE.sub(told, self.table(table))

    def written(self, page: str) -> str:
        """Returns a page with all its tables as they are now."""
        return BLOCK.sub(lambda block: f"{block[1]}{self.render(block[2])}{block[3]}", page)

    def keep(
        self,
        name: str,
        summary: Mapping[str, Any],
        commit: str,
        code: str = "",
        took_s: float = 0.0,
    ) -> None:
        """Keep what tables quote of a summary. Raises FigureError for another command's, or a
        short run's.
        """
        before = self.kept(name).command
        command = str(summary.get("command") or _as_run(before, summary))
        if _asked(command) != _asked(before):
            raise FigureError(f"{name} is of `{before}`, and this of `{command}`")
        if any(summary.get(key) for key in ("quick", "short", "unfinished")):
            raise FigureError("a short or unfinished run gives no figures")
        wanted = sorted({path for kept, path in self.quotes() if kept == name} - {*OF_ALL})
        values = {path: value_at(summary, path) for path in wanted}
        now = KeptFigures(command, commit, code, round(took_s), values)
        file = self.docs / "figures" / "kept" / f"{name}.json"
        file.write_text(json.dumps(asdict(now), indent=2, ensure_ascii=False) + "\n", "utf-8")

    def refresh(self, names: list[str], minutes: float, commit: str) -> list[str]:
        """Run the commands of some figures and keep what they give; those that took least come
        first, and none is begun that took longer than what is left. Returns what was not run, and
        why.
        """
        left_out: list[str] = []
        end_s = time.monotonic() + 60.0 * minutes
        for name in sorted(names, key=lambda name: self.kept(name).took_s):
            kept = self.kept(name)
            left_s = end_s - time.monotonic()
            if kept.took_s > left_s or left_s < 0.0:
                left_out.append(f"{name}: took {kept.took_s:.0f} s, and {left_s:.0f} s are left")
                continue
            begun_s = time.monotonic()
            with tempfile.TemporaryDirectory() as out:
                words = [*shlex.split(kept.command)[1:], "--out", out]
                command = (sys.executable, "-m", "missions.cli", *words)
                done = subprocess.run(
                    command, cwd=ROOT, capture_output=True, text=True, check=False
                )
                summary = Path(out) / "summary.json"
                if not summary.exists():
                    said = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
                    left_out.append(f"{name}: {said[0]}")
                    continue
                took_s = time.monotonic() - begun_s
                code = code_digest(rests_on(kept.command))
                self.keep(name, json.loads(_text(summary)), commit, code, took_s)
            sys.stdout.write(f"{name}: {took_s:.0f} s\n")
            sys.stdout.flush()
        return left_out

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
        return "| – | | | |" if form.startswith("findings") else "–"
    if form == "counts":
        return (
            ", ".join(f"{count} `{what}`" for what, count in value.items() if what != "committed")
            or "none"
        )
    if form.startswith("findings"):
        shown = form.removeprefix("findings").strip()
        said = {"met": ", met", "short": ", **falls short**", "measured": ""}
        row = "| {quantity} | {ours} | {interval} | {paper} | {goal}"
        return "\n".join(
            f"{row.format(**finding)}{said[finding['verdict']]} |"
            for finding in value
            if not shown or any(part in finding["quantity"] for part in shown.split("; "))
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


def _committed() -> str:
    """Return the commit that is checked out. Raises FigureError when code was changed since."""
    if _git("status", "--porcelain", "--", "*.py", "*.toml"):
        raise FigureError("the code here is not what was committed: commit it, or say --commit")
    return _git("rev-parse", "--short=8", "HEAD")


def main(folder: FigureFolder, words: list[str]) -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.docs.figures", description=__doc__)
    parser.add_argument(
        "does",
        choices=("list", "write", "keep", "refresh"),
        help="keep: a run's figures; refresh: run their commands, and keep them; both write pages",
    )
    parser.add_argument("name", nargs="?", help="what they are kept as; refresh: all if left out")
    parser.add_argument("run", nargs="?", type=Path, help="the run's folder")
    parser.add_argument(
        "--commit", help="of the code that was run; the one that is checked out when left out"
    )
    parser.add_argument("--minutes", type=float, default=MINUTES, help="for refresh, at most")
    asked = parser.parse_args(words)
    left_out: list[str] = []
    try:
        if asked.does == "list":
            for name in folder.names():
                kept = folder.kept(name)
                sys.stdout.write(
                    f"{name:<30}{kept.origin:<23}{kept.took_s:>6.0f} s  {kept.command}\n"
                )
            return 0
        if asked.does == "keep":
            commit = asked.commit or _committed()
            code = "" if asked.commit else code_digest(rests_on(folder.kept(asked.name).command))
            folder.keep(asked.name, json.loads(_text(asked.run / "summary.json")), commit, code)
        if asked.does == "refresh":
            names = [asked.name] if asked.name else folder.names()
            left_out = folder.refresh(names, asked.minutes, _committed())
        folder.write()
    except FigureError as error:
        sys.stderr.write(f"error: {error}\n")
        return 1
    for each in left_out:
        sys.stdout.write(f"not run: {each}\n")
    return 1 if left_out else 0


if __name__ == "__main__":
    sys.exit(main(FigureFolder(ROOT / "docs"), sys.argv[1:]))
