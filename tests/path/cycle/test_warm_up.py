"""Nothing that the cycles call is compiled in flight, whatever numbers a detector's boxes are made
of.
"""

from __future__ import annotations

import subprocess
import sys

import pytest

from path.cycle import warm_up

ASKED = """
import numpy as np
from path.cycle import kernels as prior, warm_up
from path.gate import kernels as pair
from path.observations import Box
from path.target import kernels as depth

compiled = (pair.judged, pair.located, pair.offset, pair.sized, prior.projected, depth.middle)
warm_up.warm_up_cycles()
assert all(len(each.signatures) == 1 for each in compiled)
warm_up.BOX = Box(*np.array((60, 60, 40, 40), np.float32))
warm_up.warm_up_cycles()
warm_up.BOX = Box(60, 60, 40, 40)
warm_up.warm_up_cycles()
assert all(len(each.signatures) == 1 for each in compiled), [each.signatures for each in compiled]
"""


def test_nothing_is_compiled_in_flight() -> None:
    subprocess.run([sys.executable, "-c", ASKED], check=True, timeout=600.0)


def no_depth(*_: object) -> None: ...


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("registered_depth", no_depth, "no depth"),
        ("SEEN_TIMES", 0, "do not agree"),  # no pair at all
        ("SEEN_TIMES", 1, "do not agree"),  # what stands beside was not seen often enough
    ],
)
def test_an_installation_that_computes_nonsense_is_told_before_the_flight(
    monkeypatch: pytest.MonkeyPatch, name: str, value: object, said: str
) -> None:
    monkeypatch.setattr(warm_up, name, value)
    with pytest.raises(RuntimeError, match=said):
        warm_up.warm_up_cycles()
