"""What is counted of code, on small modules."""

from __future__ import annotations

from tests.measures import READING_PATH, ROOT, measure

MODULE = '''"""Say what it is."""

import math  # for nothing


class Thing:
    """A thing."""

    def size(self) -> float:
        """Return its size."""
        return math.pi  # in m
'''


def test_docstrings_and_comments_are_no_tokens() -> None:
    found = measure(MODULE)
    # import math | class Thing : | def size ( self ) -> float : | return math . pi
    assert found.tokens == 2 + 3 + 8 + 4
    assert found.code_lines == 4
    assert found.classes == 1
    assert found.comment_lines == 2


def test_a_string_that_is_used_is_a_token() -> None:
    assert measure('name = "a"\n').tokens == 3


def test_lines_are_long_beyond_the_limit_only() -> None:
    at_limit = "x" * 98 + " = 1"
    assert measure(f"{at_limit[2:]}\n").long_lines == 0
    assert measure(f"{at_limit}\n").long_lines == 1


def test_the_reading_path_is_there_and_the_tour_names_it_in_order() -> None:
    tour = (ROOT / "docs" / "tour.md").read_text("utf-8")
    places = [tour.find(f"`{name}`") for name in READING_PATH]
    assert all((ROOT / name).exists() for name in READING_PATH)
    assert places == sorted(places)
    assert places[0] > 0
