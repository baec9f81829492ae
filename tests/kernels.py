"""Compiling what a fresh copy has not compiled yet, before its tests: each worker would compile it
for itself.
"""

from __future__ import annotations

import subprocess
import sys

PARTS = ("renderer", "depth", "cycles", "physics", "geometry"), ("marker", "pose", "relative")
"""That each of two processes compiles: about as much."""
LIMIT_S = 600.0


def compile_kernels() -> None:
    """Compile, or find compiled, what every harness uses. What fails here fails in its test."""
    command = [sys.executable, "-m", "hil.harness.preparation"]
    compiling = [subprocess.Popen([*command, *names], stdout=subprocess.DEVNULL) for names in PARTS]
    for process in compiling:
        process.wait(LIMIT_S)
