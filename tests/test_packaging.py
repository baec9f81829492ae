"""The installed package: the right packages, pinned, one OpenCV, and a wheel with everything in
it.
"""

from __future__ import annotations

import importlib
import re
import shutil
import sys
import tomllib
import zipfile
from importlib.metadata import entry_points
from pathlib import Path

import pytest
from hatchling.builders.wheel import WheelBuilder
from packaging.requirements import Requirement
from packaging.version import Version

from missions.field.doctor import command as doctor

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
OURS = ("path", "drivers", "flight", "missions", "hil")
REQUIREMENTS = [Requirement(line) for line in PROJECT["project"]["dependencies"]]
EXTRAS = [Requirement(line) for line in PROJECT["project"]["optional-dependencies"]["dev"]]
PINS = [
    Requirement(line)
    for line in (ROOT / "constraints.txt").read_text().splitlines()
    if not line.startswith("#")
]


def canonical(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


@pytest.mark.parametrize("name", OURS)
def test_our_packages_are_the_ones_imported(name: str) -> None:
    """PyPI has a package ``path`` too."""
    module = importlib.import_module(name)
    assert Path(str(module.__file__)).parent == ROOT / name


@pytest.mark.parametrize("requirement", REQUIREMENTS + EXTRAS, ids=lambda r: r.name)
def test_versions_are_bounded(requirement: Requirement) -> None:
    operators = {specifier.operator for specifier in requirement.specifier}
    assert operators & {"<", "=="}, "no upper bound"
    assert operators & {">=", "=="}, "no lower bound"


@pytest.mark.parametrize("requirement", REQUIREMENTS + EXTRAS, ids=lambda r: r.name)
def test_constraints_pin_what_is_required(requirement: Requirement) -> None:
    pins = [pin for pin in PINS if canonical(pin.name) == canonical(requirement.name)]
    assert pins
    for pin in pins:
        (specifier,) = pin.specifier
        assert specifier.operator == "=="
        assert Version(specifier.version) in requirement.specifier


def test_every_command_that_installs_names_its_python() -> None:
    """Uv installs into the environment that is active in the shell, whichever uv it is."""
    folders = [
        *(ROOT / "docs").rglob("*.md"),
        *(ROOT / "install").rglob("*.sh"),
        *(ROOT / "missions").rglob("*.py"),
    ]
    lines = [
        line
        for page in (ROOT / "README.md", *folders)
        for line in page.read_text("utf-8").splitlines()
    ]
    commands = [line for line in lines if "uv pip install" in line]
    assert len(commands) >= 6
    assert [line for line in commands if "--python .venv/bin/python" not in line] == []


def test_constraints_name_no_place_and_no_second_opencv() -> None:
    text = (ROOT / "constraints.txt").read_text()
    assert not re.search(r"://|@|--hash|--index|--find-links", text)
    assert [pin.name for pin in PINS if "opencv" in pin.name] == ["opencv-contrib-python-headless"]


def test_one_opencv_works_here() -> None:
    assert doctor.check_opencv().state == "ok"


def test_the_command_is_installed() -> None:
    (command,) = entry_points(group="console_scripts", name="path-handoff")
    assert callable(command.load())


def test_a_wheel_has_all_packages_and_rigs_and_nothing_else(tmp_path: Path) -> None:
    (wheel,) = WheelBuilder(str(ROOT)).build(directory=str(tmp_path), versions=["standard"])
    names = [name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name]
    assert {name.partition("/")[0] for name in names} == set(OURS)
    for package in OURS:
        wanted = {f.relative_to(ROOT).as_posix() for f in (ROOT / package).rglob("*.py")}
        wanted |= {f.relative_to(ROOT).as_posix() for f in (ROOT / package).rglob("*.toml")}
        assert wanted <= set(names)
    assert not [name for name in names if name.endswith((".pyc", ".nbi", ".nbc"))]
    assert "drivers/link/dialect/path_dialect.py" in names  # which is in no repository


def test_the_dialect_is_built_with_the_pymavlink_that_is_pinned() -> None:
    needs = [Requirement(line) for line in PROJECT["build-system"]["requires"]]
    (built_with,) = [need for need in needs if need.name == "pymavlink"]
    (pin,) = [pin for pin in PINS if pin.name == "pymavlink"]
    assert built_with.specifier == pin.specifier


def test_a_clean_copy_without_the_dialect_builds_a_wheel_that_has_it(tmp_path: Path) -> None:
    for name in ("pyproject.toml", "hatch_build.py", "README.md"):
        shutil.copy(ROOT / name, tmp_path)
    for package in OURS:
        (tmp_path / package).mkdir()
        (tmp_path / package / "__init__.py").touch()
    left_out = shutil.ignore_patterns("path_dialect.py", "__pycache__")
    shutil.copytree(ROOT / "drivers" / "link", tmp_path / "drivers" / "link", ignore=left_out)
    (wheel,) = WheelBuilder(str(tmp_path)).build(
        directory=str(tmp_path / "dist"), versions=["standard"]
    )
    dialect = Path("drivers") / "link" / "dialect" / "path_dialect.py"
    assert zipfile.ZipFile(wheel).read(dialect.as_posix()) == (ROOT / dialect).read_bytes()


def test_this_python_is_one_of_those_promised() -> None:
    assert (
        Version(".".join(map(str, sys.version_info[:3])))
        in Requirement(f"python{PROJECT['project']['requires-python']}").specifier
    )
