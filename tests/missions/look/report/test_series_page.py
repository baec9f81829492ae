"""Many runs on one page, each linked to its own."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from missions.look.report.series_page import write_series_page

SERIES = {
    "runs": 2,
    "outcomes": {"committed": 1, "target_lost": 1},
    "commit_rate": 0.5,
    "commit_rate_interval": (0.01, 0.99),
    "wrong_handovers": 0,
}


def test_each_run_has_a_row_with_its_end_and_a_link(tmp_path: Path) -> None:
    runs: list[dict[str, Any]] = [
        {"seed": 7, "outcome": "committed", "t_commit_s": 12.345, "detail": ""},
        {"seed": 8, "outcome": "target_lost", "t_commit_s": None, "detail": "sender: <gone>"},
    ]
    page = tmp_path / "runs.html"
    write_series_page(page, SERIES, runs, "path-handoff handoff --seeds 2")
    text = page.read_text("utf-8")
    assert re.findall(r"href='([^']+)'>(\d+)<", text) == [
        ("seed-0007/run.html", "7"), ("seed-0008/run.html", "8")
    ]  # fmt: skip
    rows = re.findall(r"<tr><td>.*?</tr>", text)
    assert "<td>committed</td><td>12.3</td>" in rows[0]
    assert "<td>target_lost</td><td></td>" in rows[1] and "sender: &lt;gone&gt;" in rows[1]
    assert "Committed 50.0 % (1.0 to 99.0 with 95 % confidence)" in text
