"""Spells of a detector: what it misses, and what it invents, for some frames at a time; by seed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hil.geometric.kernels import fold
from hil.world.detector import DetectorConfig
from path.camera.model import CameraModel
from path.observations import Box, Detection

LONG_AGO = 500  # frames after which a spell is drawn anew
INVENTION = -1  # in the place of a thing's number
SIDES_PX = (20.0, 120.0)  # of an invented box
SCORE = 0.6
KEYS = float(1 << 63)


@dataclass(slots=True)
class Spell:
    """A chain of two states, one step a frame. ``since``: its first frame, when it is on."""

    on: bool
    frame: int
    since: int


class Spells:
    """The spells of one camera's detector.

    Frames must be asked for in their order; what is drawn depends on their numbers and the seed
    alone.
    """

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self._chains: dict[int, Spell] = {}

    def missed(
        self,
        frame: int,
        sides_px: Sequence[float],
        config: DetectorConfig,
    ) -> tuple[int, ...]:
        """The things that the detector does not find in this frame, of those whose boxes are so
        long.
        """
        shares = [1.0 - config.recall_at(side_px) for side_px in sides_px]
        return tuple(
            k for k, share in enumerate(shares) if self._at(k, frame, share, config.miss_frames).on
        )

    def invented(
        self,
        frame: int,
        camera: CameraModel,
        config: DetectorConfig,
    ) -> Detection | None:
        """A box of nothing: in one place as long as the spell lasts."""
        spell = self._at(INVENTION, frame, config.false_positives, config.miss_frames)
        if not spell.on:
            return None
        u, v, w, h = (self._draw(10 + k, spell.since) for k in range(4))
        low, high = SIDES_PX
        w = low + (high - low) * w
        h = low + (high - low) * h
        return Detection(Box(u * camera.width - 0.5 * w, v * camera.height - 0.5 * h, w, h), SCORE)

    def _at(
        self,
        who: int,
        frame: int,
        share: float,
        frames: float,
    ) -> Spell:
        spell = self._chains.get(who)
        if spell is None or not 0 <= frame - spell.frame <= LONG_AGO:
            spell = self._chains[who] = Spell(self._draw(who, frame) < share, frame, frame)
            return spell
        ends = 1.0 / frames
        begins = min(1.0, share * ends / (1.0 - share)) if share < 1.0 else 1.0
        while spell.frame < frame:
            spell.frame += 1
            draw = self._draw(who, spell.frame)
            if not spell.on and draw < begins:
                spell.on = True
                spell.since = spell.frame
            elif spell.on and draw < ends and share < 1.0:
                spell.on = False
        return spell

    def _draw(self, who: int, frame: int) -> float:
        return float(fold(fold(self._seed, 1000 + who), frame)) / KEYS
