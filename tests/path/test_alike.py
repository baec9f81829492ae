"""What both drones must have alike: which of it differs, the first cause first."""

from __future__ import annotations

from dataclasses import fields, replace

import pytest

from path.alike import Alike, differing

OWN = Alike(1, 2, 3, 4, 5, 6, 7, 8, 400)
NAMES = [field.name for field in fields(Alike) if field.name != "first_side"]


def test_what_is_the_same_differs_in_nothing() -> None:
    assert differing(OWN, replace(OWN)) == []


@pytest.mark.parametrize("name", NAMES)
def test_each_thing_that_differs_is_named_alone(name: str) -> None:
    (found,) = differing(OWN, replace(OWN, **{name: 99}))
    assert found


def test_sides_that_differ_are_told_in_millimetres() -> None:
    assert differing(OWN, replace(OWN, sides=99, first_side=640)) == [
        "[[markers]]: side_m (40.0 mm here, 64.0 mm there)"
    ]


def test_of_other_markers_than_the_first_no_size_is_told() -> None:
    assert differing(OWN, replace(OWN, sides=99)) == ["[[markers]]: side_m"]


def test_the_version_comes_before_what_it_may_explain() -> None:
    found = differing(OWN, Alike(*(99 for _ in fields(Alike))))
    assert len(found) == len(NAMES)
    assert "path.xml" in found[0] and "version" in found[1]


def test_a_drone_that_does_not_say_is_of_an_older_version() -> None:
    (found,) = differing(OWN, None)
    assert "older" in found
