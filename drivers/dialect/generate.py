"""Regenerate ``path_dialect.py`` from ``path.xml``: ``python -m drivers.dialect.generate``.

mavgen resolves ``<include>`` beside the file, so both go into a temporary folder; ``minimal.xml`` comes with pymavlink.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from importlib.resources import files
from pathlib import Path

HERE = Path(__file__).parent
GENERATED = HERE / "path_dialect.py"
GENERATED_WITH = "2.4.50"  # the pymavlink whose output is stored


def generate(output: Path) -> None:
    """Write the Python module of the dialect to ``output``. Raises CalledProcessError with mavgen's words."""
    minimal = Path(str(files("pymavlink"))) / "dialects" / "v20" / "minimal.xml"
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        shutil.copy(HERE / "path.xml", work)
        shutil.copy(minimal, work)
        command = [sys.executable, "-m", "pymavlink.tools.mavgen", "--lang=Python3", "--wire-protocol=2.0"]
        subprocess.run(
            [*command, "--output=generated.py", "path.xml"], cwd=work, check=True, capture_output=True, text=True
        )
        shutil.copy(work / "generated.py", output)


if __name__ == "__main__":
    generate(GENERATED)
