"""Encounters: hand-overs without flights, many times faster than they would take (``flight.encounter``).

An encounter starts where an approach ends. Everything is drawn from the attempt's seed and index; observations are
those of the geometric sight with errors that last on top. They go through the compiled cycles (``play``), or through
the method itself (``play_by_method``).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from typing import Self

import numpy as np

from drivers.interfaces import PartError
from drivers.rig.parts import Rig
from flight.encounter import PAIR, Attempt, Encounter, FaultName, Series, agreeing, tell
from hil.geometric.perception import Sensor
from hil.geometric.scene import CameraSetup, lens_row
from hil.montecarlo.encounter_by_method import play_cycles
from hil.montecarlo.encounter_conditions import MEANINGS, conditions
from hil.montecarlo.encounter_method import REASONS, Rules
from hil.montecarlo.encounter_play import play
from hil.montecarlo.encounter_pose import Limits
from hil.montecarlo.encounter_relative import Believes
from hil.montecarlo.encounter_scene import Believed, Calibrated
from hil.montecarlo.encounter_stage import BLOCK_S, EPOCH_S, Parts, Stage, lever, mounting, printed_marker
from hil.montecarlo.encounter_state import (
    CAPTURE,
    DONE,
    ENTRIES,
    IOU,
    KIND,
    NEXT,
    NOW,
    OWN_FRAMES,
    REASON,
    RIGHT,
    SAME,
    SEQUENCE,
    SIGMA_M,
    Z_M,
    Setup,
    State,
    fresh,
)
from hil.montecarlo.encounter_window import Hold, hopeless
from path.config import MethodConfig
from path.marker.pose import PoseSettings
from path.messages import Role
from path.observations import MissReason
from path.receiver import SAME_OBJECT_IOU
from path.relative import RelativeSettings
from path.window import AgreementWindow

MAPPINGS = ("center", "corner")


class Encounters:
    """Implements ``flight.encounter.EncounterPlayer``."""

    def __init__(self, rig: Rig, method: MethodConfig | None = None) -> None:
        if len(rig.layout.markers) != 1:
            raise PartError(
                f"{rig.where('markers')}: encounters are played with one marker, not {len(rig.layout.markers)}",
                "use a rig with the paper's single marker",
            )
        self._method = method or rig.method
        self._believed = Believed.of(rig)
        self._parts = Parts(self._believed)
        mount = rig.sender.mount
        setup = CameraSetup(Role.SENDER, rig.sender.camera, mount.T_b_c, mount.T_b_v, rig.layout)
        self._sensor = Sensor(setup, self._believed.noise, self._method, 0)

    def warmed(self) -> Self:
        self.play(Attempt(0, 0, limit_s=0.3))
        return self

    def play(self, attempt: Attempt) -> Encounter:
        stage = Stage(attempt, self._believed, self._sensor, self._parts)
        sender, receiver = stage.frames
        state = fresh(len(sender.number), len(receiver.number))
        kinds, which, now = stage.events
        setup, hold = self._setup(stage.believed), self._hold()
        until_s, limit_ns = 0.0, round((attempt.limit_s + EPOCH_S) * 1e9)
        while state.counters[NEXT] < len(kinds) and until_s < attempt.limit_s:
            until_s = min(until_s + BLOCK_S, attempt.limit_s)
            stage.fill(until_s)
            until_ns = round((until_s + EPOCH_S) * 1e9)
            play(kinds, which, now, until_ns, stage.clock_ns, setup, hold, attempt.whole, stage.seen, state)
            if not attempt.whole and (state.counters[DONE] or hopeless(state.window, hold, until_ns, limit_ns)):
                break
        return _encounter(attempt, stage, _series(state), until_s, self._method)

    def play_by_method(self, attempt: Attempt) -> Encounter:
        stage = Stage(attempt, self._believed, self._sensor, self._parts)
        series, until_s = play_cycles(attempt, stage, self._believed, self._method)
        return _encounter(attempt, stage, series, until_s, self._method)

    def conditions(self) -> tuple[tuple[str, str], ...]:
        return conditions()

    def meanings(self) -> Mapping[FaultName, str]:
        return MEANINGS

    def _setup(self, calibrated: Calibrated) -> Setup:
        method, mission = self._method, self._believed.mission
        sigma = math.radians(mission.attitude_sigma_deg)
        settings = PoseSettings(
            attitude_v_sigma_rad=sigma,
            attitude_c_sigma_rad=sigma,
            max_incidence_rad=math.radians(method.max_incidence_deg),
            max_sigma_m=method.max_pose_sigma_m,
        )
        return Setup(
            Rules.of(method, SAME_OBJECT_IOU, mission.search_hz),
            Limits.of(settings),
            printed_marker(self._believed),
            lens_row(calibrated.camera_1),
            lens_row(calibrated.camera_2),
            mounting(calibrated),
            np.ascontiguousarray(calibrated.T_b_v.R),
            0.75 * float(np.abs(self._believed.rig.layout.markers[0].corners_v).max()) + 0.02,
            Believes.of(
                RelativeSettings(coast_s=mission.deadlines.marker_coast_s), lever(calibrated.T_b_c2),
                lever(calibrated.T_b_v),
            ),
        )  # fmt: skip

    def _hold(self) -> Hold:
        m = self._method
        return Hold(
            m.tau_min, m.tau_max, m.z0_m, m.hold_frames, round(m.hold_s * 1e9), round(m.max_gap_s * 1e9),
            MAPPINGS.index(m.box_mapping),
        )  # fmt: skip


def _series(state: State) -> Series:
    count = int(state.counters[ENTRIES])
    ints, floats = state.ints[:count], state.floats[:count]
    return Series(
        kind=ints[:, KIND].copy(),
        reason=ints[:, REASON].copy(),
        now_ns=ints[:, NOW].copy(),
        sequence=ints[:, SEQUENCE] & 0xFFFF,
        capture_ns=ints[:, CAPTURE].copy(),
        own=ints[:, OWN_FRAMES : OWN_FRAMES + 4].copy(),
        iou=floats[:, IOU : IOU + 2].copy(),
        z_m=floats[:, Z_M].copy(),
        pose_sigma_m=floats[:, SIGMA_M].copy(),
        right=ints[:, RIGHT] != 0,
        same=ints[:, SAME] != 0,
    )


def _encounter(attempt: Attempt, stage: Stage, series: Series, played_s: float, method: MethodConfig) -> Encounter:
    """The paper's gate over the series, and what came of it."""
    done = tell(series, AgreementWindow(method), method)
    agrees = agreeing(series, method)
    misses = Counter(REASONS[code].value for code in series.reason[series.kind != PAIR].tolist())
    low = int(np.sum((series.kind == PAIR) & ~agrees))
    if low:
        misses[MissReason.LOW_IOU.value] += low
    first = int(np.argmax(agrees)) if agrees.any() else None
    return Encounter(
        attempt=attempt,
        outcome="timeout" if done is None else "commit",
        start_s=None if first is None else int(series.capture_ns[first]) * 1e-9 - EPOCH_S,
        commit_s=None if done is None else int(series.now_ns[done]) * 1e-9 - EPOCH_S,
        right=None if done is None else bool(series.right[done]),
        same=None if done is None else bool(series.same[done]),
        misses=dict(misses),
        simulated_s=played_s,
        circumstances=stage.circumstances,
        series=series,
    )
