"""Generates ``path_dialect.py`` from ``path.xml``, as installing PATH does.

``python -m drivers.link.dialect.generate`` does it again after a change of the XML.

``python -m drivers.link.dialect.generate --wireshark FILE.lua [PORT ...]`` writes a dissector for
Wireshark instead, for the link's UDP ports (docs/protocol.md). Its name, fields and variables are
its own: it loads beside MAVLink's.

mavgen resolves ``<include>`` beside the file, so both go into a temporary folder; ``minimal.xml``
comes with pymavlink.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path

HERE = Path(__file__).parent
GENERATED = HERE / "path_dialect.py"
LINK_PORTS = (14601, 14602, 14611, 14612)
"""Of the rig sitl and of what ``rigs --new`` writes."""
ALONE = "local _ENV = setmetatable({}, {__index = _G}) -- what is global below is this file's own"


def generate(output: Path, language: str = "Python3") -> None:
    """Write the dialect to ``output`` in one of mavgen's languages. Raises CalledProcessError with
    mavgen's words.

    A file that has this content already stays as it is: a program that is just starting may be
    reading it.
    """
    minimal = Path(str(files("pymavlink"))) / "dialects" / "v20" / "minimal.xml"
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        shutil.copy(HERE / "path.xml", work)
        shutil.copy(minimal, work)
        command = [
            sys.executable,
            "-m",
            "pymavlink.tools.mavgen",
            f"--lang={language}",
            "--wire-protocol=2.0",
        ]
        generated = f"generated{output.suffix}"
        subprocess.run(
            [*command, f"--output={generated}", "path.xml"],
            cwd=work,
            check=True,
            capture_output=True,
            text=True,
        )
        content = (work / generated).read_bytes()
        if not output.exists() or output.read_bytes() != content:
            output.write_bytes(content)


def write_dissector(output: Path, ports: Sequence[int] = LINK_PORTS) -> None:
    """Write a dissector for Wireshark. Raises CalledProcessError with mavgen's words."""
    with tempfile.TemporaryDirectory() as folder:
        lua = Path(folder) / "path.lua"
        generate(lua, "WLua")
        text = lua.read_text("utf-8")
    begin = text.index("-- bind protocol dissector to USER0 linktype")
    bound = "".join(f'DissectorTable.get("udp.port"):add({port}, path_link)\n' for port in ports)
    text = (
        text[:begin]
        .replace("mavlink_proto", "path_link")
        .replace('"MAVLink protocol"', '"PATH link"')
        + bound
    )
    output.write_text(f"{ALONE}\n{text}", "utf-8")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description="Generate the dialect's module, or a dissector for Wireshark."
    )
    parser.add_argument(
        "--wireshark", type=Path, metavar="FILE.lua", help="write a dissector instead"
    )
    parser.add_argument(
        "ports",
        type=int,
        nargs="*",
        metavar="PORT",
        help="UDP ports of the link, for the dissector",
    )
    asked = parser.parse_args()
    if asked.wireshark is None:
        generate(GENERATED)
    else:
        write_dissector(asked.wireshark.with_suffix(".lua"), asked.ports or LINK_PORTS)
