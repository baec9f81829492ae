"""The systems of docs/systems.md say only what was measured, and the page is what is kept of their
flights.
"""

from __future__ import annotations

import tomllib

import pytest

from tests.docs import systems

# What a crew measures or chooses. Heights and distances a crew may choose, to be held against the
# plan.
MEASURED = {
    "name", "like", "level", "description", "target", "drone", "depth", "link", "height", "site", "markers",
    "sender", "receiver", "mission", "world",
}  # fmt: skip
CHOSEN = {"guard", "target", "follow", "rendezvous"}  # of [mission]
REFUSED = {
    "car-from-10m": "would do",
    "car-from-30m": "would do",
    "2hz": "4 frames a second",
    "d455-40mm": "45 mm",
    "person-8m-rangefinder": "6.0 m, or [depth] max_m = 7.9 would do",
    "person-8m-stereo": "7.2 m would do",
    "plate-20mm": "32 mm",
    "wind-10": "can be borne",
}


def test_there_are_many_and_each_is_short() -> None:
    assert len(systems.names()) >= 24
    for name in systems.names():
        assert len((systems.FOLDER / f"{name}.toml").read_text("utf-8").splitlines()) <= 40, name


@pytest.mark.parametrize("name", systems.names())
def test_a_system_says_what_was_measured_and_nothing_of_the_method(name: str) -> None:
    table = tomllib.loads((systems.FOLDER / f"{name}.toml").read_text("utf-8"))
    assert set(table) <= MEASURED
    assert set(table.get("mission", {})) <= CHOSEN


@pytest.mark.parametrize("name", systems.names())
def test_what_cannot_be_flown_is_refused_with_what_would_do(name: str) -> None:
    said = " ".join(systems.refusals(name))
    assert bool(said) == (name in REFUSED), said
    assert REFUSED.get(name, "") in said


def test_the_page_is_what_is_kept() -> None:
    page = systems.PAGE.read_text("utf-8")
    assert systems.written(page) == page  # python -m tests.docs.systems write


def test_errors_are_of_seeds_of_their_own_where_there_are_any() -> None:
    """One draw of lasting errors was in the figures of nearly all systems."""
    common = systems.Kept("a", 71000, 3, {"committed": 3}, 0, {}, 1.5, 0.01, 0.09)
    own = systems.Kept("b", 95000, 1, {"committed": 1}, 0, {}, 1.6, 0.02, 0.03)
    failed = systems.Kept("b", 95001, 1, {"target_lost": 1}, 0, {})
    assert systems.together([common, own, failed]).target_m == 0.03
    assert systems.together([common, failed]).target_m == 0.09
    assert systems.together([common, own, failed]).runs == 5


def test_no_wrong_object_was_handed_over_in_any_system() -> None:
    flown = systems.kept()
    assert flown
    assert {name for name, series in flown.items() if any(each.wrong for each in series)} == set()
