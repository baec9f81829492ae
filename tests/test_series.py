"""A series of test runs tells what failed how often, and how long each took."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from tests import series

FLAKY = """
from pathlib import Path

def test_every_other_time():
    count = Path(__file__).with_name("count")
    count.write_text(count.read_text() + "x" if count.exists() else "x")
    assert len(count.read_text()) % 2

def test_always():
    pass
"""


def test_what_fails_every_other_time_is_counted_by_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "test_flaky.py").write_text(FLAKY, "utf-8")
    bare = [sys.executable, "-m", "pytest", "-q", "-rf", "-c", str(tmp_path / "none.ini")]
    (tmp_path / "none.ini").write_text("[pytest]\n", "utf-8")
    monkeypatch.setattr(series, "PYTEST", bare)
    monkeypatch.chdir(tmp_path)
    told: list[str] = []
    assert series.main(["--times", "2", "--beside", "1", "--", "test_flaky.py"], told.append) == 1
    first, second, total, counted = told
    assert first.startswith("[1/2] ") and "2 passed" in first and "0 flown again" in first
    assert "1 failed" in second and "test_every_other_time" in second
    assert total == "1 of 2 runs failed, with 1 busy loops beside them"
    assert counted == "  1 times: test_flaky.py::test_every_other_time"
