"""One object in two boxes, as detectors give it for a frame: neither box is of something beside the
other.
"""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from path.observations import Box, Depth, Detection, Region
from tests.flight.tracking.test_association import PLACE, SECOND, FakeView, beside, settled, tracked


class Halved(FakeView):
    """Its one object comes in two boxes that overlap, as a detector gave a car for one frame of a
    flight.
    """

    def targets(self, region: Region | None) -> Sequence[Detection]:
        (box,) = super().boxes()
        pieces = [
            Box(box.x + 0.12 * box.w, box.y, 0.88 * box.w, box.h),
            Box(box.x, box.y + 2.0, 0.38 * box.w, 31.0),
        ]
        found = [Detection(piece, 0.8) for piece in pieces]
        return [d for d in found if region is None or region.contains(*d.box.center)]

    def depth(self, box: Box) -> Depth | None:
        return Depth(self._seen(self.places[0])[1], 0.01)


def test_one_object_in_two_boxes_is_no_object_beside_it() -> None:
    """So it is still followed when, half a second later, the drone's attitude is corrected by two
    degrees.
    """
    track = settled(PLACE)
    whole = FakeView([PLACE]).boxes()[0]
    seen = tracked(Halved([PLACE], track.stamp_ns + SECOND // 20), track)
    assert seen.beside == ()
    assert (seen.box.x, seen.box.y, seen.box.w, seen.box.h) == pytest.approx(
        (whole.x, whole.y, whole.w, whole.h)
    )
    for _ in range(10):
        tracked(FakeView([PLACE], track.stamp_ns + SECOND // 20), track)
    tracked(FakeView([beside(PLACE, 0.1)], track.stamp_ns + SECOND // 20), track)


class Sliced(FakeView):
    """Its first object comes as a box around it and one around half of it, as a detector gave a
    micro-UAV once.
    """

    shift: float = -0.1  # of the half's left edge from the whole's, of its width

    def targets(self, region: Region | None) -> Sequence[Detection]:
        box, *others = super().boxes()
        half = Box(box.x + self.shift * box.w, box.y + 4.0, 0.5 * box.w, 36.0)
        found = [Detection(each, 0.8) for each in (box, half, *others)]
        return [d for d in found if region is None or region.contains(*d.box.center)]

    def depth(self, box: Box) -> Depth | None:
        return Depth(self._seen(self.places[0])[1], 0.01)


def test_half_of_an_object_is_no_rival_of_the_whole() -> None:
    """So that it is still followed when the drone's attitude is corrected by two degrees."""
    track = settled(PLACE)
    for _ in range(3):
        assert tracked(Sliced([PLACE], track.stamp_ns + SECOND // 20), track).beside == ()
    tracked(FakeView([beside(PLACE, 0.1)], track.stamp_ns + SECOND // 20), track)


def test_two_halves_are_no_rivals_when_the_box_before_them_was_one_of_them() -> None:
    """What the object's box usually is counts, not its last one."""
    track = settled(PLACE)
    for _ in range(20):
        tracked(FakeView([PLACE], track.stamp_ns + SECOND // 20), track)
    assert track.size_m is not None
    wide_m, high_m = track.size_m
    track.note_size((0.6 * wide_m, high_m), track.stamp_ns)
    assert tracked(Sliced([PLACE], track.stamp_ns + SECOND // 20), track).beside == ()


def test_a_half_that_stands_out_beside_it_is_one() -> None:
    """It makes both together larger than the object: of something behind it, half of which is in
    view.
    """
    track = settled(PLACE)
    view = Sliced([PLACE], track.stamp_ns + SECOND // 20)
    view.shift = 0.9
    assert len(tracked(view, track).beside) == 1
