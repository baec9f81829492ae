"""runs.html: many runs on one page, a row each, linked to the run's own page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from missions.look.report.page import whole
from missions.look.report.records import PAGE
from missions.look.report.tables import counts_text

SERIES_PAGE = "runs.html"
SERIES_SIGN = "<title>runs: "
COLUMNS = {
    "outcome": "ended as",
    "t_commit_s": "committed after, s",
    "agreement_s": "agreement, s",
    "min_separation_m": "least separation, m",
    "d2_error_m": "error of D2, m",
    "target_error_m": "error of the target, m",
    "detail": "what was seen",
}


def write_series_page(
    path: Path,
    series: Mapping[str, Any],
    runs: Sequence[Mapping[str, Any]],
    command: str,
) -> None:
    """Write the page of many runs. Raises OSError.

    Args:
        runs: their summaries, each in a folder ``seed-NNNN`` beside the page.
    """
    low, high = (100.0 * end for end in series["commit_rate_interval"])
    said = (
        f"{series['runs']} runs: {counts_text(series['outcomes'])}. Committed"
        f" {100.0 * series['commit_rate']:.1f} % ({low:.1f} to {high:.1f} with 95 % confidence),"
        f" wrong objects {series['wrong_handovers']}."
    )
    head = "".join(f"<th>{escape(text)}</th>" for text in ("seed", *COLUMNS.values()))
    rows = "\n".join(_row(run) for run in runs)
    title = f"{SERIES_SIGN}{escape(path.parent.resolve().name)}</title>"
    body = (
        f"<h1>{escape(said)}</h1>\n<p class='dim'>Made by <code>{escape(command)}</code></p>\n"
        f"<div class='wide'><table><tr>{head}</tr>\n{rows}\n</table></div>"
    )
    path.write_text(whole(title, body), "utf-8")


def _row(run: Mapping[str, Any]) -> str:
    page = f"seed-{run['seed']:04d}/{PAGE}"
    cells = "".join(f"<td>{escape(_shown(run.get(name)))}</td>" for name in COLUMNS)
    return f"<tr><td><a href='{page}'>{run['seed']}</a></td>{cells}</tr>"


def _shown(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.3g}"
    return "" if value is None else str(value)
