"""Values that nobody may change."""

from __future__ import annotations

from dataclasses import FrozenInstanceError, asdict, field, replace

import pytest

from path.values import frozen, value


@frozen
class Place:
    north_m: float
    names: list[str] = field(default_factory=list[str])


@frozen
class NamedPlace(Place):
    title: str = ""


@frozen(eq=False)
class Seen:
    number: int


@value
class Quick:
    number: int


def test_a_frozen_one_is_equal_by_its_fields_and_cannot_be_changed() -> None:
    place = Place(1.0)
    assert place == Place(1.0) != replace(place, north_m=2.0)
    with pytest.raises(FrozenInstanceError):
        place.north_m = 3.0  # type: ignore[misc]
    assert not hasattr(place, "__dict__")


def test_a_frozen_one_has_a_frozen_heir() -> None:
    assert asdict(NamedPlace(1.0, title="home")) == {"north_m": 1.0, "names": [], "title": "home"}


def test_one_that_is_not_equal_by_its_fields_is_equal_to_itself_alone() -> None:
    seen = Seen(1)
    assert seen != Seen(1)
    assert seen in {seen}


def test_a_quick_value_is_equal_and_hashed_by_its_fields() -> None:
    assert {Quick(1), Quick(1)} == {Quick(1)} != {Quick(2)}
