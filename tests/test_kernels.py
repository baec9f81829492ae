"""What many processes load is compiled once, and before them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests import kernels


def test_modules_are_kept_compiled_whatever_the_shell_says() -> None:
    assert not sys.dont_write_bytecode
    assert "PYTHONDONTWRITEBYTECODE" not in os.environ


def test_the_tests_of_a_fresh_copy_are_collected_before_workers_collect_them_and_of_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "test_one.py").write_text("def test_it(): pass\n")
    monkeypatch.setattr(kernels, "TESTS", tmp_path)
    for _ in range(2):
        kernels.compile_tests()
        kept = list(tmp_path.rglob("test_one*-pytest-*.pyc"))
        assert len(kept) == 1

    def run(*_: object, **__: object) -> None:
        raise AssertionError("collected again")

    monkeypatch.setattr(subprocess, "run", run)
    kernels.compile_tests()
