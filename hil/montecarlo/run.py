"""Monte-Carlo hand-overs: without flights, many times faster than they would take
(``flight.harness.montecarlo``).

A hand-over starts where an approach ends. Everything is drawn from the attempt's seed and index;
observations are those of the geometric perception with errors that last on top. They go through the
method itself.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from typing import Self

import numpy as np

from drivers.interfaces import PartError
from drivers.rig.parts import Rig
from flight.harness.montecarlo import PAIR, Attempt, FaultName, MonteCarloHandover, Series, agreeing
from hil.montecarlo.conditions import MEANINGS, conditions
from hil.montecarlo.cycles import REASONS, CyclesRun, run_cycles
from hil.montecarlo.scene import Believed
from hil.montecarlo.setup import EPOCH_S, HandoverSetup
from hil.world.errors import level_of, sizes_of
from path.config import MethodConfig
from path.observations import MissReason


class MonteCarloHandovers:
    """Implements ``flight.harness.montecarlo.HandoverRunner``."""

    def __init__(self, rig: Rig, method: MethodConfig | None = None) -> None:
        if len(rig.layout.markers) != 1:
            raise PartError(
                f"{rig.where('markers')}: Monte-Carlo hand-overs need one marker, not {len(rig.layout.markers)}",
                "use a rig with the paper's single marker",
            )
        self._method = method or rig.method
        self._believed = Believed.of(rig)

    def warmed(self) -> Self:
        self.run(Attempt(0, 0, limit_s=0.3))
        return self

    def run(
        self, attempt: Attempt, until: Callable[[Series], bool] | None = None
    ) -> MonteCarloHandover:
        setup = HandoverSetup(attempt, self._believed, self._method)
        return _result(
            attempt,
            setup,
            run_cycles(attempt, setup, self._believed, self._method, until),
            self._method,
        )

    def conditions(self) -> tuple[tuple[str, str], ...]:
        return conditions(self._believed, sizes_of(level_of(self._believed.rig)))

    def meanings(self) -> Mapping[FaultName, str]:
        return MEANINGS


def _result(
    attempt: Attempt,
    setup: HandoverSetup,
    ran: CyclesRun,
    method: MethodConfig,
) -> MonteCarloHandover:
    """Return the result of an attempt by the paper's gate."""
    series = ran.series
    done = ran.done
    agrees = agreeing(series, method)[: ran.decided]
    pairs = series.kind[: ran.decided] == PAIR
    misses = Counter(REASONS[code].value for code in series.reason[: ran.decided][~pairs].tolist())
    low = int(np.sum(pairs & ~agrees))
    if low:
        misses[MissReason.LOW_IOU.value] += low
    first = int(np.argmax(agrees)) if agrees.any() else None
    return MonteCarloHandover(
        attempt=attempt,
        outcome="timeout" if done is None else "commit",
        start_s=None if first is None else int(series.capture_ns[first]) * 1e-9 - EPOCH_S,
        commit_s=None if done is None else int(series.now_ns[done]) * 1e-9 - EPOCH_S,
        right=None if done is None else bool(series.right[done]),
        same=None if done is None else bool(series.same[done]),
        misses=dict(misses),
        simulated_s=ran.simulated_s,
        circumstances=setup.circumstances,
        series=series,
        identity=tuple(setup.follower.stated),
    )
