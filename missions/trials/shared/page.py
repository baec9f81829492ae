"""The page of a trial, or of all: one HTML file with everything in it, to be read, sent and
kept.
"""

from __future__ import annotations

import base64
import platform
from collections.abc import Iterable, Sequence
from datetime import datetime
from html import escape
from importlib.metadata import version
from pathlib import Path

from missions.trials.shared.trial import TrialFinding, TrialResult, TrialTable, Verdict
from path.values import frozen

PAGE = "index.html"
MADE_BY = '<p class="dim">PATH '
"""Every page has it, and says its version next."""

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #1c1c1c; max-width: 72rem; margin: 2rem auto; padding: 0 1.2rem; }
h1 { font-size: 1.7rem; margin-bottom: .2rem; } h2 { margin-top: 3rem; border-top: 2px solid #ddd; padding-top: 1rem; }
h3 { font-size: 1rem; margin: 1.6rem 0 .3rem; }
p.dim, td.dim, figcaption { color: #666; } p.dim { margin-top: 0; }
table { border-collapse: collapse; margin: .4rem 0; font-variant-numeric: tabular-nums; }
th { text-align: left; font-weight: 600; color: #555; border-bottom: 1px solid #bbb; }
th, td { padding: .25rem .9rem .25rem 0; vertical-align: top; } tr + tr td { border-top: 1px solid #eee; }
td.met { color: #11702b; font-weight: 600; } td.short { color: #b3261e; font-weight: 600; }
code { background: #f3f3f3; padding: .1rem .35rem; border-radius: 3px; }
pre { background: #fbeceb; padding: .8rem; overflow-x: auto; }
figure { margin: 1rem 0; } img { max-width: 100%; height: auto; } div.wide { overflow-x: auto; }
"""


@frozen
class Chapter:
    """One trial on the page.

    Attributes:
        command: what runs it again.
        folder: where its pictures are.
        result: None when the trial failed; ``error`` says why.
    """

    name: str
    title: str
    paper: str
    command: str
    folder: Path
    wall_s: float
    result: TrialResult | None
    error: str = ""


def render_page(chapters: Sequence[Chapter], planned: int) -> str:
    """The page as text.

    Args:
        planned: number of trials there will be when all have run; a page of fewer says so.
    """
    title = chapters[0].title if planned == 1 else "The evaluation of PATH"
    parts = [f"<h1>{escape(title)}</h1>", f"{MADE_BY}{escape(_provenance(chapters))}</p>"]
    if len(chapters) < planned:
        parts.append(f"<p><b>Not finished:</b> {len(chapters)} of {planned} trials have run.</p>")
    if planned > 1:
        parts.append(_overview(chapters))
    parts += [_chapter(chapter, alone=planned == 1) for chapter in chapters]
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{STYLE}</style></head>\n<body>\n"
        + "\n".join(parts)
        + "\n</body></html>\n"
    )


def _provenance(chapters: Sequence[Chapter]) -> str:
    seconds = sum(chapter.wall_s for chapter in chapters)
    return (
        f"{version('path-handoff')}, Python {platform.python_version()}, {platform.machine()}; "
        f"{datetime.now():%Y-%m-%d %H:%M}; {seconds:.0f} s"
    )


def _overview(chapters: Sequence[Chapter]) -> str:
    """Every finding that has a figure of the paper or a goal beside it."""
    rows: list[str] = []
    for chapter in chapters:
        link = f'<a href="#{chapter.name}">{escape(chapter.name)}</a>'
        if chapter.result is None:
            rows.append(
                f'<tr><td>{link}</td><td colspan="5">failed</td><td class="short">failed</td></tr>'
            )
            continue
        compared = [finding for finding in chapter.result.findings if finding.paper or finding.goal]
        for finding in compared or chapter.result.findings[:1]:
            rows.append(f"<tr><td>{link}</td>{_cells(finding)}</tr>")
            link = ""
    heads = "".join(f"<th>{head}</th>" for head in ("trial", *FINDING_HEADS))
    return f'<div class="wide"><table><tr>{heads}</tr>{"".join(rows)}</table></div>'


FINDING_HEADS = ("", "ours", "95 % interval", "paper", "goal", "verdict")


def _cells(finding: TrialFinding) -> str:
    said: dict[Verdict, str] = {"met": "met", "short": "falls short", "measured": ""}
    texts = (finding.quantity, finding.ours, finding.interval, finding.paper, finding.goal)
    return "".join(f"<td>{escape(text)}</td>" for text in texts) + (
        f'<td class="{finding.verdict}">{said[finding.verdict]}</td>'
    )


def _chapter(chapter: Chapter, *, alone: bool) -> str:
    paper = f"Paper: {chapter.paper}. " if chapter.paper else ""
    parts = [] if alone else [f'<h2 id="{chapter.name}">{escape(chapter.title)}</h2>']
    parts.append(
        f'<p class="dim">{escape(paper)}Took {chapter.wall_s:.0f} s. Again: <code>{escape(chapter.command)}</code></p>'
    )
    if chapter.result is None:
        return "\n".join(
            [*parts, f"<p><b>This trial failed:</b></p><pre>{escape(chapter.error)}</pre>"]
        )
    result = chapter.result
    parts.append(_findings(result.findings))
    parts += [_picture(chapter.folder / file, caption) for file, caption in result.pictures.items()]
    parts += [_table(table) for table in result.tables]
    if result.noise is not None:
        parts.append(_table(result.noise))
    parts += [f"<p>{escape(note)}</p>" for note in result.notes]
    return "\n".join(parts)


def _findings(findings: Iterable[TrialFinding]) -> str:
    rows: list[str] = []
    for finding in findings:
        rows.append(f"<tr>{_cells(finding)}</tr>")
        if finding.note:
            rows.append(
                f'<tr><td></td><td class="dim" colspan="5">{escape(finding.note)}</td></tr>'
            )
    heads = "".join(f"<th>{head}</th>" for head in FINDING_HEADS)
    return f'<div class="wide"><table><tr>{heads}</tr>{"".join(rows)}</table></div>'


def _table(table: TrialTable) -> str:
    heads = "".join(f"<th>{escape(head)}</th>" for head in table.columns)
    rows = "".join(
        f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in table.rows
    )
    note = f'<p class="dim">{escape(table.note)}</p>' if table.note else ""
    return f'<h3>{escape(table.title)}</h3><div class="wide"><table><tr>{heads}</tr>{rows}</table></div>{note}'


def _picture(file: Path, caption: str) -> str:
    """The picture itself in the page: one file is the whole report."""
    data = base64.b64encode(file.read_bytes()).decode("ascii")
    return (
        f'<figure><img alt="{escape(caption, quote=True)}" src="data:image/png;base64,{data}">'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )
