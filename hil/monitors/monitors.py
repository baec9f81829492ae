"""Safety monitors of a run: they see truth and every decision of both roles, and count what must
never happen.

Records are those the roles log; a monitor recomputes from them and believes no role's own count.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from flight.config import GuardConfig
from hil.autopilot.values import OffboardSession
from hil.monitors.agreed_pairs import PairsAtPaces
from hil.monitors.claims import Claims
from hil.monitors.leases import LeaseMonitor
from hil.monitors.scripts import ScriptMonitor
from hil.monitors.setpoints import SetpointGap, detail_of
from hil.world.distances import LEAST_M
from path.config import MethodConfig
from path.messages import Role
from path.protocol.values import ProtocolConfig

MAX_FAILSAFE_S = 1.0
LEASES = frozenset({"/responsibility", "/commit", "/epoch", "/decision"})
OF_THE_AWAKE = frozenset({"S7", "L1", "L2"})  # bounds in time, of programs that run
# of programs that find what they wrote down
OF_THE_RECORD = frozenset({"S1", "S2", "S3", "S4", "S5", "L1", "L2"})


@dataclass(slots=True)
class Monitors:
    """S1 to S10, L1 and L2. Stamps are of the world's clock.

    S1, S5, S6, S8 and S9 are here; S2, S3, S4, L1 and L2 in ``leases``; S7 and S10 in ``scripts``.

    Attributes:
        stalls: a program is made to stand still: the bounds in time of programs that run are then
            not violated.
        forgotten: a disk has lost a record that it said it had: what was promised of responsibility
            is since then not violated.
        beyond: what broke after one of these.
        gaps: the gaps between setpoints that were violations of a script that nobody had cut off.
    """

    method: MethodConfig
    min_separation_m: float
    guard: GuardConfig = field(default_factory=GuardConfig)
    protocol: ProtocolConfig = field(default_factory=ProtocolConfig)
    violations: Counter[str] = field(default_factory=Counter[str])
    details: list[str] = field(default_factory=list[str])
    closest_m: float = math.inf
    stalls: bool = False
    forgotten: bool = False
    beyond: list[str] = field(default_factory=list[str])
    gaps: list[SetpointGap] = field(default_factory=list[SetpointGap])
    _claims: Claims[Role] = field(default_factory=Claims[Role])
    _too_close: bool = False
    _too_close_to_target: bool = False
    _agreed: PairsAtPaces = field(init=False)
    _committed: set[int] = field(default_factory=set[int])

    leases: LeaseMonitor = field(init=False)
    scripts: ScriptMonitor = field(init=False)

    def __post_init__(self) -> None:
        self._agreed = PairsAtPaces(self.method)
        self.leases = LeaseMonitor(self._violated, self.protocol)
        self.scripts = ScriptMonitor(self._violated, self.guard)

    def on_record(self, role: Role, topic: str, stamp_w_ns: int, record: Mapping[str, Any]) -> None:
        """One record of a role's log."""
        if topic == "/frame":
            self.scripts.on_frame(role, stamp_w_ns * 1e-9)
        elif topic == "/agreement":
            self._on_agreement(stamp_w_ns, record)
        elif topic == "/phase":
            self.scripts.on_phase(role, stamp_w_ns * 1e-9, str(record["phase"]))
        elif topic in LEASES:
            self.leases.on_record(role, topic, stamp_w_ns, record)
            if topic == "/responsibility":
                self._on_responsibility(role, stamp_w_ns, record)
            elif topic == "/commit":
                self._on_commit(stamp_w_ns, record)

    def on_death(self, role: Role) -> None:
        """Its program does not run any more: it does nothing, until it is started again and says
        what it is.
        """
        self._claims.drop(role)
        self.leases.on_death(role)
        self.scripts.on_death(role)

    def on_truth(self, time_s: float, separation_m: float, both_in_air: bool) -> None:
        """True distance between the two bodies (S9); each excursion below the minimum counts
        once.
        """
        if not both_in_air:
            return
        self.closest_m = min(self.closest_m, separation_m)
        too_close = separation_m < self.min_separation_m
        if too_close and not self._too_close:
            self._violated(
                "S9",
                time_s,
                f"separation {separation_m:.2f} m is below {self.min_separation_m:.2f} m",
            )
        self._too_close = too_close

    def on_target(self, time_s: float, nearest_m: float) -> None:
        """True distance in m from the target's body to a drone's in the air (S9); each time below
        the least counts.
        """
        too_close = nearest_m < LEAST_M
        if too_close and not self._too_close_to_target:
            self._violated(
                "S9", time_s, f"{nearest_m:.2f} m from the target, below {LEAST_M:.2f} m"
            )
        self._too_close_to_target = too_close

    def on_offboard(
        self, role: Role, sessions: Iterable[OffboardSession], cut_off_s: Sequence[float] = ()
    ) -> None:
        """Setpoint gaps of one vehicle (S8).

        Args:
            cut_off_s: when the harness itself stopped the setpoints (a killed program, a dead link
                to the vehicle): then a gap is no violation as long as the vehicle held and landed
                in time. World's clock.
        """
        for session in sessions:
            end_s = math.inf if session.end_s is None else session.end_s
            gaps = [SetpointGap(role.value, *gap) for gap in session.long_gaps]
            cut_off = any(session.start_s <= at_s <= end_s for at_s in cut_off_s)
            if cut_off:
                self._on_cut_off(gaps, session.end_s is None)
                continue
            for gap in gaps:
                self.gaps.append(gap)
                self._violated("S8", gap.from_s, detail_of(gap))

    def _on_cut_off(self, gaps: Sequence[SetpointGap], goes_on: bool) -> None:
        """The setpoints stopped through no fault of the script's: its vehicle is to hold and land
        in time.
        """
        if not gaps:
            return
        longest = max(gaps, key=lambda gap: gap.long_s)
        if longest.long_s > MAX_FAILSAFE_S:
            self._violated("S8", longest.from_s, detail_of(longest))
        elif goes_on:
            self._violated(
                "S8", longest.from_s, f"{longest.who}: no failsafe after the setpoints stopped"
            )

    def on_forgotten(self, time_s: float, role: Role) -> None:
        """A program that is started again finds an older record than it had written, or none."""
        self.forgotten = True
        self.details.append(
            f"at {time_s:.2f} s the {role.value}'s disk had lost what it said it had"
        )

    @property
    def broken(self) -> tuple[str, ...]:
        """The assumptions that were."""
        return (*(("stall",) if self.stalls else ()), *(("disk",) if self.forgotten else ()))

    def _violated(self, name: str, time_s: float, what: str) -> None:
        told = f"{name} at {time_s:.2f} s: {what}"
        if (self.stalls and name in OF_THE_AWAKE) or (self.forgotten and name in OF_THE_RECORD):
            self.beyond.append(told)
            return
        self.violations[name] += 1
        self.details.append(told)

    def _on_responsibility(self, role: Role, stamp_w_ns: int, record: Mapping[str, Any]) -> None:
        self._claims.note(role, record)
        if len(self._claims.holders(stamp_w_ns * 1e-9)) > 1:
            self._violated("S1", stamp_w_ns * 1e-9, "two responsible drones")

    def _on_agreement(self, stamp_w_ns: int, record: Mapping[str, Any]) -> None:
        if not record["agreed"]:
            if record["counted"]:
                self._agreed.missed(record)
            return
        wrong = self._agreed.agreed(record)
        if wrong is not None:
            self._violated("S6", stamp_w_ns * 1e-9, wrong)

    def _on_commit(self, stamp_w_ns: int, record: Mapping[str, Any]) -> None:
        if record["epoch"] in self._committed:  # said again, until it is answered
            return
        self._committed.add(record["epoch"])
        agreed = self._agreed
        if not ((record["target_id"], record["epoch"]) == agreed.about and agreed.full):
            what = f"commit to target {record['target_id']} after {agreed}"
            self._violated("S5", stamp_w_ns * 1e-9, what)
