from __future__ import annotations

import importlib.util
import re
import tomllib
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import Any

import pytest

from drivers.link.dialect import generate, path_dialect

PROJECT = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text())
BUILT_WITH = next(
    need for need in PROJECT["build-system"]["requires"] if need.startswith("pymavlink")
).removeprefix("pymavlink==")


def layout(module: Any) -> dict[int, tuple[Any, ...]]:
    """Returns all that another program must agree on to understand a packet."""
    return {
        number: (kind.msgname, kind.crc_extra, kind.ordered_fieldnames, bytes(kind.native_format))
        for number, kind in module.mavlink_map.items()
    }


@pytest.fixture(scope="module")
def regenerated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    output = tmp_path_factory.mktemp("dialect") / "again.py"
    generate.generate(output)
    return output


def test_the_installed_module_has_the_layouts_of_the_xml(regenerated: Path) -> None:
    spec = importlib.util.spec_from_file_location("again", regenerated)
    assert spec is not None and spec.loader is not None
    again = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(again)
    assert layout(path_dialect) == layout(again)


@pytest.mark.skipif(version("pymavlink") != BUILT_WITH, reason="another mavgen writes other text")
def test_the_installed_module_is_reproduced_byte_for_byte(regenerated: Path) -> None:
    assert generate.GENERATED.read_bytes() == regenerated.read_bytes()


def test_a_module_that_is_as_it_should_be_is_left_alone(regenerated: Path) -> None:
    before = regenerated.stat().st_mtime_ns
    generate.generate(regenerated)
    assert regenerated.stat().st_mtime_ns == before


def test_our_ids_are_in_no_public_dialect() -> None:
    ours = {
        number
        for number, kind in path_dialect.mavlink_map.items()
        if kind.msgname.startswith("PATH_")
    }
    assert len(ours) == 10
    folder = Path(str(files("pymavlink"))) / "dialects" / "v20"
    for xml in folder.glob("*.xml"):
        public = {
            int(number)
            for number in re.findall(r'<message id="(\d+)"', xml.read_text(encoding="utf-8"))
        }
        assert not ours & public, xml.name


def test_the_dissector_for_wireshark_knows_every_message(tmp_path: Path) -> None:
    output = tmp_path / "path.lua"
    generate.write_dissector(output)
    dissector = output.read_text("utf-8")
    for number, kind in path_dialect.mavlink_map.items():
        assert f"[{number}] = '{kind.msgname}'" in dissector
