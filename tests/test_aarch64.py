"""Companions are aarch64: everything that PATH needs there comes as a wheel at the pinned versions,
says the index.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
TIMEOUT_S = 60.0
# docs/companion.md; the marker in pyproject.toml says the same
REALSENSE_WHEELS = {"3.11": False, "3.12": True}
NO_WHEEL = re.compile(r"has no (\S+ )?wheels", re.ASCII)
NOT_ASKED = re.compile(
    r"network was disabled|offline|error sending request|timed out|[Ff]ailed to fetch", re.ASCII
)
# it would fetch the Python that it resolves for
ENVIRONMENT = {**os.environ, "UV_PYTHON_DOWNLOADS": "never"}
PIN = re.compile(r"^([\w.-]+)==", re.MULTILINE)


@cache
def uv() -> str:
    beside = Path(sys.executable).with_name("uv")
    found = str(beside) if beside.exists() else shutil.which("uv")
    if found is None:
        pytest.skip("uv is not installed: pip install uv")
    return found


def resolved(python: str, *what: str, given: str = "") -> str:
    """What uv resolves to wheels for aarch64, glibc 2.28; skips where the index could not be
    asked.
    """
    order = [
        uv(), "pip", "compile", "--quiet", "--no-header", "--no-annotate", "--only-binary", ":all:",
        "--python-platform", "aarch64-unknown-linux-gnu", "--python-version", python, *what,
    ]  # fmt: skip
    try:
        done = subprocess.run(
            order,
            cwd=ROOT,
            env=ENVIRONMENT,
            input=given,
            capture_output=True,
            text=True,
            timeout=TIMEOUT_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        pytest.skip(f"the package index did not answer within {TIMEOUT_S:g} s")
    if done.returncode == 0:
        return done.stdout
    said = done.stderr.strip()
    if not NO_WHEEL.search(said) or NOT_ASKED.search(said):
        pytest.skip(f"the package index could not be asked: {said[-300:]}")
    raise LookupError(said)


def wheels_of(python: str, *what: str) -> set[str]:
    """Names of what is needed; fails in uv's words when a pin has no wheel, skips where the index
    has none at all.
    """
    try:
        return set(PIN.findall(resolved(python, *what)))
    except LookupError as missing:
        try:
            resolved(python, "-", given="numpy\nmsgspec\n")
        except LookupError:
            pytest.skip("this package index has no wheels for aarch64 at all")
        pytest.fail(
            f"constraints.txt does not resolve to wheels for aarch64 and Python {python}:\n{missing}\n"
            "pin another version, mark the dependency for where it has wheels, or say so in docs/companion.md"
        )


@pytest.mark.parametrize("python", REALSENSE_WHEELS)
def test_everything_that_flies_comes_as_a_wheel_for_aarch64(python: str) -> None:
    """The extra ``view`` too: a companion may be looked at."""
    names = wheels_of(python, "pyproject.toml", "--extra", "view", "-c", "constraints.txt")
    assert {
        "numba",
        "opencv-contrib-python-headless",
        "mavsdk",
        "av",
        "onnxruntime",
        "rerun-sdk",
    } <= names
    assert ("pyrealsense2" in names) == REALSENSE_WHEELS[python]


@pytest.mark.parametrize(
    ("said", "expected"),
    [
        ("No solution found ... Because a==1 has no wheels with a matching platform tag (e.g., `x`) and", LookupError),
        ("No solution found ... Because a was not found in the package registry and", pytest.skip.Exception),
        ("No solution found ... Packages were unavailable because the network was disabled", pytest.skip.Exception),
        ("error: Failed to fetch: `somewhere`", pytest.skip.Exception),
        ("error: unexpected argument '--python-platform' found", pytest.skip.Exception),
    ],
    ids=["no wheel", "not there", "offline", "unreachable", "an older uv"],
)  # fmt: skip
def test_only_a_missing_wheel_is_a_failure(
    said: str, expected: type[BaseException], monkeypatch: pytest.MonkeyPatch
) -> None:
    def run(order: Sequence[str], **_: object) -> subprocess.CompletedProcess[str]:
        return subprocess.CompletedProcess(order, 1, "", said)

    monkeypatch.setattr(subprocess, "run", run)
    with pytest.raises(expected):
        resolved("3.12", "pyproject.toml")
