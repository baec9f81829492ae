"""Safety monitors of a run: they see truth and every decision of its drones, and count what must
never happen. A pair's are those of two drones and one leg.

Records are those the roles log; a monitor recomputes from them and believes no role's own count.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Self

from flight.config import GuardConfig, MissionConfig
from hil.autopilot.values import OffboardSession
from hil.monitors.agreed_pairs import PairsAtPaces
from hil.monitors.claims import Claims
from hil.monitors.leases import LeaseMonitor, Violated
from hil.monitors.scripts import ScriptMonitor
from hil.monitors.setpoints import SetpointGap, detail_of
from hil.world.distances import LEAST_M, Nearness
from path.config import MethodConfig
from path.messages import Role
from path.protocol.values import ProtocolConfig

MAX_FAILSAFE_S = 1.0
LEASES = frozenset({"/responsibility", "/commit", "/epoch", "/decision"})
OF_THE_AWAKE = frozenset({"S7", "L1", "L2"})  # bounds in time, of programs that run
# of programs that find what they wrote down
OF_THE_RECORD = frozenset({"S1", "S2", "S3", "S4", "S5", "L1", "L2"})


@dataclass(slots=True)
class LegMonitor:
    """S5 and S6, and S2, S3, S4, L1 and L2 in ``leases``, of one hand-over by its drones' records."""

    number: int
    roles: Mapping[str, Role]
    method: MethodConfig
    violated: Violated
    leases: LeaseMonitor
    _agreed: PairsAtPaces = field(init=False)
    _committed: set[int] = field(default_factory=set[int])

    def __post_init__(self) -> None:
        self._agreed = PairsAtPaces(self.method)

    def on_record(self, who: str, topic: str, stamp_w_ns: int, record: Mapping[str, Any]) -> None:
        if topic == "/agreement":
            self._on_agreement(stamp_w_ns, record)
        elif topic in LEASES:
            self.leases.on_record(self.roles[who], topic, stamp_w_ns, record)
            if topic == "/commit":
                self._on_commit(stamp_w_ns, record)

    def _on_agreement(self, stamp_w_ns: int, record: Mapping[str, Any]) -> None:
        if not record["agreed"]:
            if record["counted"]:
                self._agreed.missed(record)
            return
        wrong = self._agreed.agreed(record)
        if wrong is not None:
            self.violated("S6", stamp_w_ns * 1e-9, wrong)

    def _on_commit(self, stamp_w_ns: int, record: Mapping[str, Any]) -> None:
        if record["epoch"] in self._committed:  # said again, until it is answered
            return
        self._committed.add(record["epoch"])
        agreed = self._agreed
        if not ((record["target_id"], record["epoch"]) == agreed.about and agreed.full):
            what = f"commit to target {record['target_id']} after {agreed}"
            self.violated("S5", stamp_w_ns * 1e-9, what)


@dataclass(slots=True)
class Monitors:
    """S1 to S11, L1 and L2, of drones by name. Stamps are of the world's clock.

    S1, S8, S9, and S11 at obstacles, are here; S7, S10, and S11 at walls, in ``scripts``; the
    others in the monitors of the legs.

    Attributes:
        stalls: a program is made to stand still: the bounds in time of programs that run are then
            not violated.
        forgotten: a disk has lost a record that it said it had: what was promised of responsibility
            is since then not violated.
        beyond: what broke after one of these.
        obstacle_m: the least distance of a body to what stood in the way.
        gaps: the gaps between setpoints that were violations of a script that nobody had cut off.
    """

    method: MethodConfig
    min_separation_m: float
    guard: GuardConfig = field(default_factory=GuardConfig)
    protocol: ProtocolConfig = field(default_factory=ProtocolConfig)
    violations: Counter[str] = field(default_factory=Counter[str])
    details: list[str] = field(default_factory=list[str])
    closest_m: float = math.inf
    closest_pair: tuple[str, ...] = ()
    obstacle_m: float = math.inf
    stalls: bool = False
    forgotten: bool = False
    beyond: list[str] = field(default_factory=list[str])
    gaps: list[SetpointGap] = field(default_factory=list[SetpointGap])
    claims: Claims = field(default_factory=Claims)
    scripts: ScriptMonitor = field(init=False)
    legs: list[LegMonitor] = field(default_factory=list[LegMonitor])
    # the newest of each drone
    _legs: dict[str, LegMonitor] = field(default_factory=dict[str, LegMonitor])
    _near: set[tuple[str, ...]] = field(default_factory=set[tuple[str, ...]])
    _too_close_to_target: bool = False
    _touching: set[str] = field(default_factory=set[str])

    def __post_init__(self) -> None:
        self.scripts = ScriptMonitor(self.violated, self.guard)

    @classmethod
    def of_pair(cls, method: MethodConfig, mission: MissionConfig | None = None) -> Self:
        """Return those of a pair, which are called by their roles."""
        mission = mission or MissionConfig()
        protocol = ProtocolConfig.of_clocks(mission.clock_uncertainty_s)
        made = cls(method, mission.separation.minimum_m, mission.guard, protocol)
        made.on_leg(1, *Role)
        return made

    def on_leg(self, number: int, sender: str, receiver: str) -> None:
        """Two drones begin a hand-over."""

        def violated(name: str, time_s: float, what: str) -> None:
            self.violated_in(number, name, time_s, what)

        roles = {sender: Role.SENDER, receiver: Role.RECEIVER}
        leases = LeaseMonitor(violated, self.protocol)
        leg = LegMonitor(number, roles, self.method, violated, leases)
        self._legs[sender] = self._legs[receiver] = leg
        self.legs.append(leg)

    def on_record(self, who: str, topic: str, stamp_w_ns: int, record: Mapping[str, Any]) -> None:
        """One record of a drone's log."""
        now_s = stamp_w_ns * 1e-9
        if who in self._legs:
            self._legs[who].on_record(who, topic, stamp_w_ns, record)
        if topic == "/frame":
            self.scripts.on_frame(who, now_s)
        elif topic == "/phase":
            self.scripts.on_phase(who, now_s, str(record["phase"]))
        elif topic == "/responsibility":
            self._on_responsibility(who, now_s, record)

    def on_death(self, who: str) -> None:
        """Its program does not run any more: it does nothing, until it is started again and says
        what it is.
        """
        self.claims.drop(who)
        if who in self._legs:
            leg = self._legs[who]
            leg.leases.on_death(leg.roles[who])
        self.scripts.on_death(who)

    def on_near(self, now_s: float, near: Nearness) -> None:
        """True distances between bodies in the air (S9); each excursion below the minimum counts
        once.
        """
        if near.closest_m < self.closest_m:
            self.closest_m = near.closest_m
            self.closest_pair = near.pair
        for one, other, apart_m in near.too_near:
            if (one, other) not in self._near:
                self.violated("S9", now_s, f"{one} and {other} are {apart_m:.2f} m apart")
        self._near = {(one, other) for one, other, _ in near.too_near}

    def on_target(self, time_s: float, nearest_m: float) -> None:
        """True distance in m from the target's body to a drone's in the air (S9); each time below
        the least counts.
        """
        too_close = nearest_m < LEAST_M
        if too_close and not self._too_close_to_target:
            self.violated("S9", time_s, f"{nearest_m:.2f} m from the target, below {LEAST_M:.2f} m")
        self._too_close_to_target = too_close

    def on_obstacles(self, time_s: float, nearest_m: Mapping[str, float]) -> None:
        """True distance in m of each body to what stands in its way (S11); each touch counts once."""
        touching = {who for who, away_m in nearest_m.items() if away_m <= 0.0}
        for who in sorted(touching - self._touching):
            self.violated("S11", time_s, f"{who} touches an obstacle")
        self._touching = touching
        self.obstacle_m = min((self.obstacle_m, *nearest_m.values()))

    def on_offboard(
        self, who: str, sessions: Iterable[OffboardSession], cut_off_s: Sequence[float] = ()
    ) -> None:
        """Setpoint gaps of one vehicle (S8).

        Args:
            cut_off_s: when the harness itself stopped the setpoints (a killed program, a dead link
                to the vehicle): then a gap is no violation as long as the vehicle held and landed
                in time. World's clock.
        """
        for session in sessions:
            end_s = math.inf if session.end_s is None else session.end_s
            gaps = [SetpointGap(who, *gap) for gap in session.long_gaps]
            cut_off = any(session.start_s <= at_s <= end_s for at_s in cut_off_s)
            if cut_off:
                self._on_cut_off(gaps, session.end_s is None)
                continue
            for gap in gaps:
                self.gaps.append(gap)
                self.violated("S8", gap.from_s, detail_of(gap))

    def _on_cut_off(self, gaps: Sequence[SetpointGap], goes_on: bool) -> None:
        """The setpoints stopped through no fault of the script's: its vehicle is to hold and land
        in time.
        """
        if not gaps:
            return
        longest = max(gaps, key=lambda gap: gap.long_s)
        if longest.long_s > MAX_FAILSAFE_S:
            self.violated("S8", longest.from_s, detail_of(longest))
        elif goes_on:
            self.violated(
                "S8", longest.from_s, f"{longest.who}: no failsafe after the setpoints stopped"
            )

    def on_forgotten(self, time_s: float, who: str) -> None:
        """A program that is started again finds an older record than it had written, or none."""
        self.forgotten = True
        self.details.append(f"at {time_s:.2f} s the {who}'s disk had lost what it said it had")

    @property
    def broken(self) -> tuple[str, ...]:
        """The assumptions that were."""
        return (*(("stall",) if self.stalls else ()), *(("disk",) if self.forgotten else ()))

    def violated(self, name: str, time_s: float, what: str) -> None:
        told = f"{name} at {time_s:.2f} s: {what}"
        if (self.stalls and name in OF_THE_AWAKE) or (self.forgotten and name in OF_THE_RECORD):
            self.beyond.append(told)
            return
        self.violations[name] += 1
        self.details.append(told)

    def violated_in(self, leg: int, name: str, time_s: float, what: str) -> None:
        """A monitor of a leg; a pair has one."""
        del leg
        self.violated(name, time_s, what)

    def _on_responsibility(self, who: str, now_s: float, record: Mapping[str, Any]) -> None:
        self.claims.note(who, record)
        self._at_once(self.claims.holders(now_s), now_s)

    def _at_once(self, holders: Sequence[str], now_s: float) -> None:
        if len(holders) > 1:
            self.violated("S1", now_s, f"responsible at once: {', '.join(sorted(holders))}")
