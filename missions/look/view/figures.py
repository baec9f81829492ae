"""The values plotted of a log's records. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

Record = Mapping[str, Any]
Figure = tuple[str, float]
"""Kind of plot and name in it, value."""


class PlottedValues:
    """Of one log."""

    def __init__(self) -> None:
        self._before: dict[str, tuple[int, Record]] = {}
        self._of: dict[str, Callable[[int, Record], Iterable[tuple[str, Any]]]] = {
            "/agreement": lambda _, record: _agreement(record),
            "/marker": lambda _, record: _marker(record),
            "/scene": lambda _, record: [("separation/limit_m", record["min_separation_m"])],
            "/truth": lambda _, record: _truth(record),
            "/frame": lambda _, record: [("age/frame_ms", record["age_ns"] * 1e-6)],
            "/state": lambda _, record: [("battery/left", record["battery"])],
            "/link": self._link,
            "/cpu": self._cpu,
        }

    def of(
        self,
        topic: str,
        utc_ns: int,
        record: Record,
    ) -> Iterator[Figure]:
        """The figures of a record; what does not apply is left out."""
        make = self._of.get(topic)
        for path, value in () if make is None else make(utc_ns, record):
            if value is not None:
                yield path, float(value)

    def _link(self, utc_ns: int, record: Record) -> Iterator[Figure]:
        for name in ("bytes_sent", "bytes_received"):
            yield from self._rate(f"link/{name}_per_s", "/link", utc_ns, record, name)
        self._before["/link"] = utc_ns, record

    def _cpu(self, utc_ns: int, record: Record) -> Iterator[Figure]:
        spent = record["spent_ns"] or {}
        for stage in spent:
            for path, per_s in self._rate(f"processor/{stage}", "/cpu", utc_ns, spent, stage):
                yield path, 1e-7 * per_s
        self._before["/cpu"] = utc_ns, spent

    def _rate(
        self,
        path: str,
        topic: str,
        utc_ns: int,
        record: Record,
        name: str,
    ) -> Iterator[Figure]:
        """Per second since the record before."""
        before_ns, before = self._before.get(topic, (utc_ns, {}))
        if utc_ns > before_ns and name in before:
            yield path, (record[name] - before[name]) / (utc_ns - before_ns) * 1e9


def _agreement(record: Record) -> Iterator[tuple[str, Any]]:
    for plot, names in (
        ("overlap", ("iou", "tau")),
        ("count", ("count", "needed")),
        ("evidence", ("evidence", "evidence_needed")),
    ):
        yield from ((f"{plot}/{name}", record[name]) for name in names)


def _marker(record: Record) -> Iterator[tuple[str, Any]]:
    if record["position_v_m"] is not None:
        yield "separation/marker_m", math.hypot(*record["position_v_m"])
        yield "separation/sigma_m", record["sigma_m"]


def _truth(record: Record) -> Iterator[Figure]:
    """Of two drones; in a relay or a team there is no one distance."""
    bodies = [body["t"] for body in record.values() if isinstance(body, Mapping) and "q" in body]
    if len(bodies) == 2:
        yield "separation/true_m", math.dist(*bodies)
