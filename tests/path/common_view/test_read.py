"""Keyframes of RGB-D pictures: what they cannot be read from is said."""

from __future__ import annotations

from dataclasses import replace

import pytest

from path.common_view.read import RgbdCamera
from tests.path.common_view.drawn import LENS


@pytest.mark.parametrize("which", ["colour", "depth"])
def test_a_lens_that_bends_is_refused_and_not_taken_as_straight(which: str) -> None:
    bent = replace(LENS, distortion=(0.1, -0.2, 0.0, 0.0, 0.0))
    color, depth = (bent, LENS) if which == "colour" else (LENS, bent)
    with pytest.raises(ValueError, match=f"the {which} camera's lens bends"):
        RgbdCamera(color, depth, None, 0.002)
