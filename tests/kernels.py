"""Compiling what a fresh copy has not compiled yet, before its tests: each worker would compile it
for itself.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

PARTS = (
    ("renderer", "depth", "cycles", "physics", "geometry"),
    ("marker", "pose", "relative"),
    ("common view",),
)
"""That each of three processes compiles: about as much."""
LIMIT_S = 600.0
TESTS = Path(__file__).parent


def compile_kernels() -> list[subprocess.Popen[bytes]]:
    """Begin to compile, or to find compiled, what every harness uses. What fails here fails in its
    test.
    """
    command = [sys.executable, "-m", "hil.harness.preparation"]
    return [subprocess.Popen([*command, *names], stdout=subprocess.DEVNULL) for names in PARTS]


def compile_tests() -> None:
    """Collect all tests once, if that was never done here: pytest keeps what it makes of a
    module.
    """
    if next(TESTS.rglob("__pycache__/test_*-pytest-*.pyc"), None) is None:
        command = [sys.executable, "-m", "pytest", "--numprocesses=0", "--collect-only", str(TESTS)]
        subprocess.run(command, stdout=subprocess.DEVNULL, timeout=LIMIT_S, check=False)
