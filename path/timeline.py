"""A short history of samples, asked at instants between them: the cameras of two drones do not fire
together.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

Values = tuple[float, ...]


class Sample(NamedTuple):
    """One frame's values, or None where the frame gave none. ``frame``: strictly increasing frame
    number.
    """

    stamp_ns: int
    frame: int
    values: Values | None


class Between(NamedTuple):
    """Values interpolated at an instant, and the two samples around it (the same one twice when it
    hits it).
    """

    before: Sample
    after: Sample
    values: Values


class Track:
    """A bounded ring of samples in order of stamp and frame number. Oldest ones fall out.

    Samples without values stay in the ring: nothing is interpolated across a frame that saw
    nothing.
    """

    def __init__(self, length: int, max_bracket_s: float) -> None:
        """``max_bracket_s``: samples farther apart are not interpolated between."""
        self._samples: deque[Sample] = deque(maxlen=length)
        self._max_bracket_ns = round(max_bracket_s * 1e9)

    @property
    def newest(self) -> Sample | None:
        return self._samples[-1] if self._samples else None

    def add(self, sample: Sample) -> None:
        """Raise ValueError unless stamp and frame number are both later than the newest ones."""
        newest = self.newest
        if newest is not None and (
            sample.stamp_ns <= newest.stamp_ns or sample.frame <= newest.frame
        ):
            raise ValueError(f"sample {sample!r} does not come after {newest!r}")
        self._samples.append(sample)

    def find(self, frame_u16: int) -> Sample | None:
        """The newest sample whose frame number ends in these 16 bits."""
        for sample in reversed(self._samples):
            if sample.frame & 0xFFFF == frame_u16:
                return sample
        return None

    def at(self, stamp_ns: int) -> Between | None:
        """Linear interpolation at an instant; None outside the track, across a gap, next to a frame
        without values.
        """
        after: Sample | None = None
        for sample in reversed(self._samples):
            if sample.stamp_ns > stamp_ns:
                after = sample
                continue
            if sample.values is None:
                return None
            if sample.stamp_ns == stamp_ns:
                return Between(sample, sample, sample.values)
            if after is None or after.values is None:
                return None
            span = after.stamp_ns - sample.stamp_ns
            if span > self._max_bracket_ns:
                return None
            fraction = (stamp_ns - sample.stamp_ns) / span
            values = tuple(
                [a + fraction * (b - a) for a, b in zip(sample.values, after.values, strict=True)]
            )
            return Between(sample, after, values)
        return None

    def ahead(
        self,
        stamp_ns: int,
        slope_span_s: float,
        limit_s: float,
    ) -> Values | None:
        """Linear extrapolation beyond the newest sample, at most ``limit_s``; None further on or
        without values.

        The slope is taken from the newest sample and the oldest one within ``slope_span_s`` before
        it that is connected to it (no gap, no frame without values); a lone sample stands still.
        """
        newest = self.newest
        if (
            newest is None
            or newest.values is None
            or not 0 <= stamp_ns - newest.stamp_ns <= limit_s * 1e9
        ):
            return None
        oldest = newest
        for sample in reversed(self._samples):
            connected = oldest.stamp_ns - sample.stamp_ns <= self._max_bracket_ns
            if (
                sample.values is None
                or not connected
                or newest.stamp_ns - sample.stamp_ns > slope_span_s * 1e9
            ):
                break
            oldest = sample
        if oldest is newest or oldest.values is None:
            return newest.values
        factor = (stamp_ns - newest.stamp_ns) / (newest.stamp_ns - oldest.stamp_ns)
        return tuple(
            [b + factor * (b - a) for a, b in zip(oldest.values, newest.values, strict=True)]
        )
