"""Every number that a rig, a calibration or another file of the user's can say has a unit and
bounds.
"""

from __future__ import annotations

import dataclasses
import importlib
import math
import pkgutil
from collections.abc import Iterator
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import pytest

import drivers
import hil
from drivers.rig.calibration_file import CameraCalibration, CameraTable, MountCalibration, Quality
from drivers.rig.file import _Camera, _RigTable  # pyright: ignore[reportPrivateUsage]
from drivers.rig.mounts import CameraMount, MarkerMount
from flight.config import MissionConfig
from flight.harness.fleet import RelayConfig, TeamConfig
from hil.world.config import WorldConfig
from missions.field.calibrate.mount import MeasuredMount
from missions.ground import rig_library
from missions.trials.real.set import RealSetFile
from path.bounds import Bounds, bounds_of, numbers, unit_of
from tests.every_rig import every_name

STATED = (Quality,)
"""A calibration's words on itself: nothing is computed with them."""
CHECKED = ("CameraCalibration.version", "MountCalibration.version")
"""Compared with the one value that there is."""


def parts() -> Iterator[type[Any]]:
    """The Config of every class in ``drivers`` and ``hil`` that a rig can name as a part."""
    for package in (drivers, hil):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            for each in list(vars(importlib.import_module(module.name)).values()):
                config = getattr(each, "Config", None) if isinstance(each, type) else None
                if isinstance(config, type) and dataclasses.is_dataclass(config):
                    yield config


ROOTS = {
    *parts(), _RigTable, MissionConfig, RelayConfig, TeamConfig, WorldConfig, CameraTable, CameraMount,
    MarkerMount, CameraCalibration, MountCalibration, MeasuredMount, RealSetFile,
}  # fmt: skip


def leaves(hint: Any, bounds: Bounds | None = None) -> Iterator[tuple[Any, Bounds | None]]:
    """The innermost types of an annotation, with the bounds around them."""
    if get_origin(hint) is Annotated:
        yield from leaves(get_args(hint)[0], bounds_of(hint) or bounds)
    elif get_origin(hint) is Literal:
        return
    elif get_origin(hint) in (Union, UnionType, tuple, dict, list):
        for inner in get_args(hint):
            yield from leaves(inner, bounds)
    else:
        yield hint, bounds


def every_field() -> Iterator[tuple[str, str, Any, Bounds | None, Any]]:
    waiting, seen = list(ROOTS), set[type[Any]]()
    while waiting:
        kind = waiting.pop()
        if kind in seen or kind in STATED:
            continue
        seen.add(kind)
        hints = get_type_hints(kind, include_extras=True)
        for each in dataclasses.fields(kind):
            for leaf, bounds in leaves(hints[each.name]) if each.init else ():
                if (
                    isinstance(leaf, type)
                    and dataclasses.is_dataclass(leaf)
                    and not hasattr(leaf, "from_table")
                ):
                    waiting.append(leaf)
                elif leaf in (int, float) and f"{kind.__name__}.{each.name}" not in CHECKED:
                    yield kind.__name__, each.name, leaf, bounds, each.default


FIELDS = sorted(every_field(), key=lambda field: field[:2])
TABLES = sorted({field[0] for field in FIELDS})  # the same in every worker


def test_there_are_many() -> None:
    assert len(FIELDS) > 300
    assert _Camera  # is read as a CameraTable, which is among the roots


@pytest.mark.parametrize("table", TABLES)
def test_numbers_have_units_and_bounds_that_their_defaults_are_within(table: str) -> None:
    for kind, name, _, bounds, default in FIELDS:
        if kind != table:
            continue
        assert bounds is not None, f"{name}: no bounds"
        assert unit_of(name, bounds), f"{name}: no unit, neither in its name nor in its bounds"
        assert -math.inf < bounds.low < bounds.high < math.inf, name
        assert all(bounds.holds(each) for each in numbers(default) if math.isfinite(each)), name


@pytest.mark.parametrize("rig", every_name())
def test_every_rig_that_is_shipped_passes(rig: str) -> None:
    assert rig_library.load(rig).name
