"""The page of licences names every part that is installed with PATH, and copyleft by its name."""

from __future__ import annotations

import re
import tomllib
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, metadata
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "licences.md").read_text("utf-8")
ROWS = [row for row in PAGE.splitlines() if row.startswith("| `")]


def installed() -> list[str]:
    """Return the names of all parts of an installation without the tools of development."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    extras = project["optional-dependencies"]
    wanted = [*project["dependencies"], *extras["view"], *extras["cluster"], *extras["ros-live"]]
    names = [re.match(r"[\w.-]+", each) for each in wanted]
    return sorted({name[0] for name in names if name is not None})


def test_every_part_has_its_row() -> None:
    named = {name for row in ROWS for name in re.findall(r"`([\w.-]+)`", row.split(" | ")[0])}
    assert named == set(installed())


def test_what_a_package_states_as_copyleft_is_said_to_be() -> None:
    stated: dict[str, str] = {}
    for name in installed():
        with suppress(PackageNotFoundError):  # an extra that is not here
            stated[name] = str(metadata(name).json.get("license") or "")
    # some put the whole text there, which may speak of other licences
    copyleft = [name for name, licence in stated.items() if "GPL" in licence[:40]]
    assert "pymavlink" in copyleft
    rows = {name: row for row in ROWS for name in copyleft if f"`{name}`" in row.split(" | ")[0]}
    assert all("GPL" in rows[name] for name in copyleft)
