"""Pieces of a campaign on a Dask cluster: the same orders, done by its workers. The one place that
knows Dask.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TextIO, TypeVar

from drivers.interfaces import PartError
from missions.ground.work import Bars

Item = TypeVar("Item")
Result = TypeVar("Result")

CONNECT_S = 10.0
LOST_AFTER = 3  # times that a piece may be begun again because its worker was lost


class ClusterWork:
    """A cluster's workers, which have this version of PATH installed. Made by ``open_cluster``."""

    def __init__(
        self,
        client: Any,
        as_completed: Any,
        bars: Bars,
    ) -> None:
        self._client = client
        self._as_completed = as_completed
        self._bars = bars

    def stream(
        self,
        what: str,
        piece: Callable[[Item], Result],
        items: Sequence[Item],
    ) -> Iterator[Result]:
        """The results as they come. Raises what a piece raised, and PartError when the cluster is
        lost.
        """
        futures = self._client.map(piece, items, pure=False, retries=LOST_AFTER)
        try:
            with self._bars.bar(what, len(items)) as advance:
                for future in self._as_completed(futures):
                    yield future.result()
                    future.release()
                    advance()
        finally:
            self._client.cancel(futures)


@contextmanager
def open_cluster(address: str, stream: TextIO | None = None) -> Generator[ClusterWork, None, None]:
    """Raise PartError when Dask is not installed, or nobody answers at the address."""
    try:
        from distributed import Client, as_completed  # type: ignore[import-not-found]  # noqa: PLC0415
    except ImportError as error:
        raise PartError(
            "--cluster needs Dask, which is not installed here",
            "pip install 'path-handoff[cluster]'",
        ) from error
    try:
        client = Client(address, timeout=CONNECT_S)
    except (OSError, ValueError) as error:
        raise PartError(
            f"no Dask scheduler at {address}: {error}",
            "start one with `dask scheduler`, and name the address it prints",
        ) from error
    try:
        if not client.scheduler_info()["workers"]:
            raise PartError(
                f"the cluster at {address} has no workers",
                f"start some with `dask worker {address}`",
            )
        yield ClusterWork(client, as_completed, Bars(stream or sys.stdout))
    finally:
        client.close(timeout=CONNECT_S)
