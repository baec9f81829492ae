"""The log of a program, which the monitors read as it is written."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from drivers.interfaces import Frame, FrameLog, Log
from flight.harness.relay import OFTEN
from hil.monitors.claims import in_world_time
from hil.monitors.monitors import LEASES


class WatchedLog:
    """
    Args:
        log: where it goes; of what comes ``OFTEN`` only when ``whole``.
        heard: takes each record, with its stamp on the world's clock.
        offset_ns: the program's clock minus the world's.
    """

    def __init__(
        self, log: Log, who: str, heard: Callable[[str, str, int, Mapping[str, Any]], None], offset_ns: int,
        whole: bool = True,
    ) -> None:  # fmt: skip
        self._log = log
        self._who = who
        self._heard = heard
        self._offset_ns = offset_ns
        self._whole = whole
        self.ended = False  # the program was killed: what it does on its way out has not happened

    def write(self, topic: str, stamp_ns: int, record: Mapping[str, Any]) -> None:
        if self.ended:
            return
        seen = in_world_time(record, self._offset_ns) if topic in LEASES else record
        self._heard(self._who, topic, stamp_ns - self._offset_ns, seen)
        if self._whole or topic not in OFTEN:
            self._log.write(topic, stamp_ns, record)

    def image(self, topic: str, stamp_ns: int, image: Any) -> None:
        if not self.ended and self._whole:
            self._log.image(topic, stamp_ns, image)

    def frame(self, frame: Frame) -> None:
        if not self.ended and self._whole and isinstance(self._log, FrameLog):
            self._log.frame(frame)
