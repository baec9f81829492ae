"""What earlier frames told of a marker, so that the fit of the next one starts from the answer.

To ask an image what is wrong, see ``misfit``, takes most of a fit's time, and the answers last: the
inner edges of a print stay where they are, and what no term explains in one frame, none explains in
the next. So edges are learned from frame to frame, each a step of one least-squares problem, and
what was asked in vain is asked again only when more is left than then.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from path.marker.kernels import Array
from path.marker.photometric.kernels import START_BLUR_PX
from path.marker.photometric.misfit import EDGE_SIGMA, FILTERED, SHADOWED

FORGETTING = 0.97  # a frame: edges seem elsewhere in another light, or from nearer
BLOOMING = 0.02  # cells, rms: growth of inner edges that is the camera's
LEVEL_GAIN = 0.05  # of a frame, in what is usually left
AGAIN = 1.25  # times what is usually left, from which on it is asked what is wrong
# frames after which edges are learned from every fourth alone
LEARNED = 6
LEARN_EVERY = 4
QUESTIONS = (FILTERED, SHADOWED)


@dataclass(slots=True)
class Known:
    """What is known of one marker of n cells, as one camera sees it.

    Attributes:
        offsets: (2 (n - 1),) of its inner edges in cells, those along x first.
        information: of them, (2 (n - 1), 2 (n - 1)).
        frames: number of fits that this is from; 0 as long as nothing is known.
        blur_px, tone: of the newest fit.
        left: residual over contrast that is usually left when all was asked.
        question: place in QUESTIONS of what was answered or is asked next.
        extra: the unknowns that answered it in the newest fit; None when nothing did.
        own: this is from frames of its own, not of other markers alone.
    """

    offsets: Array
    information: Array
    frames: int = 0
    blur_px: float = START_BLUR_PX
    tone: float = 0.0
    left: float = 0.0
    question: int = 0
    extra: Array | None = None
    own: bool = True

    @classmethod
    def nothing(cls, cells: int) -> Known:
        """Return what is known before the first frame."""
        size = 2 * (cells - 1)
        return cls(np.zeros(size), np.eye(size) / EDGE_SIGMA**2)

    @classmethod
    def among(cls, others: Iterable[Known], cells: int) -> Known:
        """Return what is known before its first frame of a marker of a camera that has seen others:
        how much its image is blurred, what else is not ideal about it, and how much that usually
        leaves. Where this print's inner edges are it learns from frame to frame.
        """
        own = cls.nothing(cells)
        seen = max(others, key=lambda each: each.frames, default=own)
        if seen.frames == 0 or len(seen.offsets) != len(own.offsets):
            return own
        own.frames = 1
        own.blur_px = seen.blur_px
        own.tone = seen.tone
        own.left = seen.left
        own.question = seen.question
        own.own = False
        return own

    def forget(self) -> None:
        """Ask everything again in the next frame."""
        self.frames = 0
        self.extra = None

    def learn_anew(self) -> None:
        """Learn edges quickly again, from where they are."""
        self.frames = 1
        self.information = np.eye(len(self.offsets)) / EDGE_SIGMA**2

    @property
    def believed(self) -> Array:
        """Offsets, but for what of their growth from the middle is likely light that blooms over
        the frame's outer edges: the more, the less edges are off otherwise.
        """
        by_axis = self.offsets.reshape(2, -1)
        growth = np.arange(by_axis.shape[1]) - 0.5 * (by_axis.shape[1] - 1)
        growth /= np.linalg.norm(growth)
        grown = np.outer(by_axis @ growth, growth)
        other2 = float(np.mean((by_axis - grown) ** 2))
        return (by_axis - BLOOMING**2 / (BLOOMING**2 + other2) * grown).ravel()

    def moved(self, edges: Array) -> Array:
        """Return edges (2, n + 1) where this print has them."""
        own = edges.copy()
        own[:, 1:-1] += self.believed.reshape(2, -1)
        return own

    @property
    def learns(self) -> bool:
        """Whether this frame is one to learn edges from."""
        return self.frames < LEARNED or self.frames % LEARN_EVERY == 0

    def learn(
        self,
        normal: Array,
        ideal: int,
        variance: float,
    ) -> None:
        """Better the edges by one frame's normal equations.

        Args:
            normal: (k, k + 1), upper triangle, of ``ideal`` unknowns and the offsets, gradient
                last.
            variance: of a pixel's residual, as if all were independent.
        """
        whole = np.triu(normal[:, :-1]) + np.triu(normal[:, :-1], 1).T
        ridge = 1e-9 * np.eye(ideal)
        through = np.linalg.solve(whole[:ideal, :ideal] + ridge, whole[:ideal, ideal:])
        alone = whole[ideal:, ideal:] - whole[ideal:, :ideal] @ through
        pull = normal[ideal:, -1] - normal[:ideal, -1] @ through
        before = FORGETTING * self.information
        self.information = before + alone / variance
        told = before @ self.offsets + (alone @ self.believed + pull) / variance
        self.offsets = np.asarray(np.linalg.solve(self.information, told), np.float64)


Memory = dict[int, Known]
"""By marker id, of one camera."""
