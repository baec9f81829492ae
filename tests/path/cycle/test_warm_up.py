"""Nothing that the cycles call is compiled in flight, whatever numbers a detector's boxes are made of."""

from __future__ import annotations

import subprocess
import sys

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
