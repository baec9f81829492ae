"""Pictures that are drawn when somebody looks at them, or before, in a thread, when somebody is
likely to.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from threading import Lock

from drivers.interfaces import Frame
from path.arrays import Depths, Image

Images = tuple[Image, Depths]
"""Colour (h, w, 3) and depth (h, w) of one picture."""


class PendingPicture:
    """One picture: drawn once, by whoever comes first. ``looked`` says whether anybody but the
    thread asked for it.
    """

    __slots__ = ("_draw", "_images", "_lock", "looked")

    def __init__(self, draw: Callable[[], Images], lock: Lock) -> None:
        """``lock``: held while it is drawn; shared by all pictures of one renderer, which draws one
        at a time.
        """
        self._draw: Callable[[], Images] | None = draw
        self._images: Images | None = None
        self._lock = lock
        self.looked = False

    def images(self) -> Images:
        """Return what it shows. Raises what drawing it raises."""
        self.looked = True
        return self._drawn()

    def begin(self, thread: ThreadPoolExecutor) -> None:
        """Have it drawn in a thread, if nobody asks for it before."""
        thread.submit(self._drawn)

    def _drawn(self) -> Images:
        with self._lock:
            if self._images is None:
                assert self._draw is not None
                self._images = self._draw()
                self._draw = None
            return self._images


class DrawnFrame(Frame):
    """A frame of a picture that may not be drawn yet."""

    __slots__ = ("_picture", "_size")

    def __init__(
        self,
        stamp_ns: int,
        frame_id: int,
        picture: PendingPicture,
        size: tuple[int, int],
    ) -> None:
        """``size``: width and height of both images."""
        for name, told in (
            ("stamp_ns", stamp_ns),
            ("frame_id", frame_id),
            ("_picture", picture),
            ("_size", size),
        ):
            object.__setattr__(self, name, told)

    @property
    def color(self) -> Image:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self._picture.images()[0]

    @property
    def depth_mm(self) -> Depths:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self._picture.images()[1]

    @property
    def sizes(self) -> Mapping[str, tuple[int, int]]:
        return {"colour": self._size, "depth": self._size}
