"""Generates ``path_dialect.py`` from ``path.xml``, as installing PATH does.

``python -m drivers.link.dialect.generate`` does it again after a change of the XML.

``python -m drivers.link.dialect.generate --wireshark FILE.lua`` writes a dissector for Wireshark instead; put it into
the folder that Wireshark calls "Personal Lua Plugins".

mavgen resolves ``<include>`` beside the file, so both go into a temporary folder; ``minimal.xml`` comes with pymavlink.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
from importlib.resources import files
from pathlib import Path

HERE = Path(__file__).parent
GENERATED = HERE / "path_dialect.py"


def generate(output: Path, language: str = "Python3") -> None:
    """Write the dialect to ``output`` in one of mavgen's languages. Raises CalledProcessError with mavgen's words.

    A file that has this content already stays as it is: a program that is just starting may be reading it.
    """
    minimal = Path(str(files("pymavlink"))) / "dialects" / "v20" / "minimal.xml"
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        shutil.copy(HERE / "path.xml", work)
        shutil.copy(minimal, work)
        command = [sys.executable, "-m", "pymavlink.tools.mavgen", f"--lang={language}", "--wire-protocol=2.0"]
        generated = f"generated{output.suffix}"
        subprocess.run(
            [*command, f"--output={generated}", "path.xml"], cwd=work, check=True, capture_output=True, text=True
        )
        content = (work / generated).read_bytes()
        if not output.exists() or output.read_bytes() != content:
            output.write_bytes(content)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Generate the dialect's module, or a dissector for Wireshark.")
    parser.add_argument("--wireshark", type=Path, metavar="FILE.lua", help="write a dissector instead")
    dissector: Path | None = parser.parse_args().wireshark
    if dissector is None:
        generate(GENERATED)
    else:
        generate(dissector.with_suffix(".lua"), "WLua")
