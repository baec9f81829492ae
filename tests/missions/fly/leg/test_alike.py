"""Digests of a rig: what both drones must have alike changes them, and nothing else does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.rig.parts import Rig
from flight.config import MissionConfig
from missions.fly.leg import alike
from missions.fly.leg.alike import alike_of
from missions.ground import rig_library
from path.alike import BITS, Alike, differing
from path.geometry.transforms import Pose
from path.marker.layout import Marker, MarkerLayout

SEPARATION = MissionConfig().separation


@pytest.fixture(scope="module")
def sim() -> Rig:
    return rig_library.load("sim")


def of(rig: Rig) -> Alike:
    return alike_of(rig, SEPARATION)


def with_marker(rig: Rig, dictionary: str | None = None, **changes: Any) -> Rig:
    marker = rig.layout.markers[0]
    said: dict[str, Any] = {
        "id": marker.id,
        "side_m": marker.side_m,
        "side_sigma_m": marker.side_sigma_m,
        "T_v_m": marker.T_v_m,
    }
    layout = MarkerLayout((Marker(**(said | changes)),), dictionary or rig.layout.dictionary)
    return replace(rig, layout=layout)


def moved(rig: Rig, by_m: float) -> Rig:
    T = rig.layout.markers[0].T_v_m
    return with_marker(rig, T_v_m=Pose(T.R, T.t + np.array([by_m, 0.0, 0.0])))


OTHERS: dict[str, Callable[[Rig], Rig]] = {
    "side_m (40.0 mm here, 64.0 mm there)": lambda rig: with_marker(rig, side_m=0.064),
    "side_m (40.0 mm here, 40.1 mm there)": lambda rig: with_marker(rig, side_m=0.0401),
    "dictionary or the ids": lambda rig: with_marker(rig, id=rig.layout.markers[0].id + 1),
    "the dictionary": lambda rig: with_marker(rig, "DICT_4X4_100"),
    "position_v_m or rpy_deg": lambda rig: moved(rig, 0.01),
    "[method]": lambda rig: replace(rig, method=replace(rig.method, tau_min=0.3)),
    "[origin]": lambda rig: replace(
        rig, origin=replace(rig.origin, latitude_deg=rig.origin.latitude_deg + 1e-4)
    ),
}


@pytest.mark.parametrize("said", OTHERS)
def test_what_must_be_alike_and_differs_is_named(sim: Rig, said: str) -> None:
    (found,) = differing(of(sim), of(OTHERS[said](sim)))
    assert said in found


def test_the_least_separation_must_be_alike(sim: Rig) -> None:
    wider = replace(SEPARATION, horizontal_m=SEPARATION.horizontal_m + 0.1)
    assert differing(of(sim), alike_of(sim, wider)) == ["[mission.separation]"]


SAME: dict[str, Callable[[Rig], Rig]] = {
    "the name": lambda rig: replace(rig, name="another"),
    "the sender's camera": lambda rig: replace(
        rig, sender=replace(rig.sender, camera=rig.receiver.camera)
    ),
    "how well a side is known": lambda rig: with_marker(rig, side_sigma_m=0.0002),
    "the last digits of a side": lambda rig: with_marker(
        rig, side_m=rig.layout.markers[0].side_m * (1.0 + 1e-12)
    ),
    "the last digits of a place": lambda rig: moved(rig, 1e-12),
}


@pytest.mark.parametrize("what", SAME)
def test_what_each_drone_has_of_its_own_may_differ(sim: Rig, what: str) -> None:
    assert of(SAME[what](sim)) == of(sim)


def test_a_digest_fits_its_bits_and_is_never_nothing() -> None:
    most = 2**BITS - 1
    found = [alike._number(each.to_bytes(4, "big")) for each in (0, most - 1, most, most + 1)]
    assert found == [1, most, 1, 2]


def test_where_a_program_is_begun_is_no_version_of_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    before = alike._code.__wrapped__()
    (tmp_path / "own.py").write_text("mine = 1\n")
    assert alike._code.__wrapped__() == before


def test_another_program_is_another_version(
    sim: Rig, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    own = of(sim)
    alike._code.cache_clear()
    (tmp_path / "gate.py").write_text("needed = 349\n")
    monkeypatch.setattr(alike, "__file__", str(tmp_path / "alike.py"))
    found = differing(own, of(sim))
    alike._code.cache_clear()
    assert found == ["the version of PATH"]
