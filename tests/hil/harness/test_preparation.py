"""Kernels are compiled once in a process, whatever it found in numba's cache, and by two
processes only then.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext

import pytest

import path.marker.warm_up
from hil.harness import preparation
from missions.ground import rig_library
from tests import kernels


def test_a_process_whose_kernels_were_not_there_prepares_for_its_first_flight_only(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    compiled: list[str] = []
    helpers: list[Sequence[str]] = []
    said: list[str] = []

    def help_with(names: Sequence[str]) -> nullcontext[None]:
        helpers.append(names)
        return nullcontext()

    monkeypatch.setattr(preparation, "_prepared", set[str]())
    monkeypatch.setattr(preparation, "compile_part", compiled.append)
    monkeypatch.setattr(preparation, "helped", help_with)
    monkeypatch.setattr(preparation.os, "cpu_count", lambda: 2)
    # numba counts for as long as the process lives
    monkeypatch.setattr(path.marker.warm_up, "is_compiled", lambda: False)
    for _ in range(3):
        preparation.prepare(rig_library.load("sim"), said.append)
    assert sorted(compiled) == ["cycles", "geometry", "physics", "pose", "relative"]
    assert len(said) == 5
    assert [list(names) for names in helpers] == [["pose", "relative"], [], []]
    # another perception has more of them
    preparation.prepare(rig_library.load("sim-rendered"), said.append)
    assert sorted(compiled[5:]) == ["depth", "marker", "renderer"]


def test_the_tests_have_every_part_compiled_before_they_begin() -> None:
    assert sorted(name for names in kernels.PARTS for name in names) == sorted(preparation.PARTS)
