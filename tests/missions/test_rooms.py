"""The rooms of ``missions``: who comes in finds one folder, and nothing stands beside them but the
way in.
"""

from __future__ import annotations

from pathlib import Path

import missions

ROOMS = {"fly", "field", "look", "trials", "proofs", "ground"}
WAYS_IN = {"__init__.py", "cli.py", "own.py"}


def test_missions_is_rooms_by_who_comes_in_and_two_ways_in() -> None:
    home = Path(missions.__file__).parent
    found = {entry.name for entry in home.iterdir() if entry.name != "__pycache__"}
    assert found == ROOMS | WAYS_IN
