"""Epochs, leases and gaps, from the roles' records of a hand-over: S2, S3, S4, L1 and L2.

What a role wrote down (``/epoch``) is there before it acts on it, so the order of the records is
the order of the acts, across restarts too. Stamps are of the world's clock.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from hil.monitors.claims import Claims
from path.messages import Role
from path.protocol.bounds import commit_bound_s, gap_bound_s
from path.protocol.values import ProtocolConfig

Violated = Callable[[str, float, str], None]


@dataclass(slots=True)
class _Lease:
    """The newest COMMIT."""

    epoch: int
    given_s: float
    end_s: float


@dataclass(slots=True)
class LeaseMonitor:
    """Watches both roles' records.

    Attributes:
        config: the deadlines of the roles that are watched.
        decision_s: the longest wait from a COMMIT to the sender's decision.
        gap_s: the longest time with nobody responsible that ended; an orphan's does not.
    """

    violated: Violated
    config: ProtocolConfig = field(default_factory=ProtocolConfig)
    decision_s: float | None = None
    gap_s: float | None = None
    _highest: dict[Role, int] = field(default_factory=lambda: dict.fromkeys(Role, 0))
    _duty: dict[Role, str] = field(default_factory=lambda: dict.fromkeys(Role, ""))
    _claims: Claims = field(default_factory=Claims)
    _lease: _Lease | None = None
    _awaited: bool = False
    _died: bool = False  # the sender, since the newest COMMIT that it lived to log
    _alone_s: float | None = None

    @property
    def figures(self) -> dict[str, float]:
        """Return what was timed, in s by name."""
        timed = {"commit_s": self.decision_s, "gap_s": self.gap_s}
        return {name: value for name, value in timed.items() if value is not None}

    def on_record(self, role: Role, topic: str, stamp_w_ns: int, record: Mapping[str, Any]) -> None:
        now_s = stamp_w_ns * 1e-9
        if topic == "/epoch":
            self._on_epoch(role, now_s, int(record["epoch"]), str(record["duty"]))
        elif topic == "/commit":
            self._on_commit(now_s, int(record["epoch"]), record["lease_end_ns"] * 1e-9)
        elif topic == "/responsibility":
            self._on_responsibility(role, now_s, record)
        elif topic == "/decision" and role is Role.SENDER:
            self._on_decision(now_s)

    def on_death(self, role: Role) -> None:
        """A program that does not run decides nothing and holds nothing."""
        self._claims.drop(role)
        self._duty[role] = ""  # it may have written down what it did not live to say
        self._alone_s = None
        if role is Role.SENDER:
            self._awaited = False
            self._died = True

    def _on_epoch(self, role: Role, now_s: float, epoch: int, duty: str) -> None:
        if epoch < self._highest[role]:
            self.violated(
                "S2",
                now_s,
                f"the {role.value} wrote epoch {epoch} down after {self._highest[role]}",
            )
        self._highest[role] = max(self._highest[role], epoch)
        self._duty[role] = duty
        if duty == "idle":  # landed, and begins a new mission: what it had is over
            self._alone_s = None

    def _on_commit(self, now_s: float, epoch: int, end_s: float) -> None:
        if Role.SENDER in self._claims.holders(now_s) or self._duty[Role.SENDER] not in (
            "released",
            "",
        ):
            self.violated("S4", now_s, "COMMIT before the release was written down and done")
        self._died = False
        if self._lease is None or self._lease.epoch != epoch:
            self._lease = _Lease(epoch, now_s, end_s)
            self._awaited = True

    def _on_responsibility(self, role: Role, now_s: float, record: Mapping[str, Any]) -> None:
        before = role in self._claims.holders(now_s)
        self._claims.note(role, record)
        if record["responsible"] and not before:
            if role is Role.SENDER:
                self._took_back(now_s)
            elif record["until_ns"] is not None:
                self._took_over(now_s, record["until_ns"] * 1e-9)
        self._on_gap(role, before, now_s)

    def _took_back(self, now_s: float) -> None:
        if self._duty[Role.SENDER] == "handed_over":
            self.violated("S4", now_s, "the sender took back what was accepted")
        if self._lease is not None and now_s < self._lease.end_s:
            self.violated(
                "S4", now_s, f"taken back {self._lease.end_s - now_s:.3f} s before the lease's end"
            )

    def _took_over(self, now_s: float, until_s: float) -> None:
        epoch = self._highest[Role.RECEIVER]
        begun = self._highest[Role.SENDER]
        if epoch < begun:
            self.violated("S2", now_s, f"taken over in epoch {epoch}, when {begun} had begun")
        if self._lease is None or self._lease.epoch != self._highest[Role.RECEIVER]:
            if not self._died:
                self.violated("S3", now_s, "taken over without a COMMIT of this epoch")
        elif now_s >= self._lease.end_s:
            self.violated(
                "S3", now_s, f"taken over {now_s - self._lease.end_s:.3f} s after the lease's end"
            )
        elif until_s > self._lease.end_s:
            self.violated(
                "S3",
                now_s,
                f"taken until {until_s - self._lease.end_s:.3f} s after the lease's end",
            )

    def _on_decision(self, now_s: float) -> None:
        if not self._awaited or self._lease is None:
            return
        self._awaited = False
        waited_s = now_s - self._lease.given_s
        self.decision_s = max(waited_s, self.decision_s or 0.0)
        bound_s = commit_bound_s(self.config)
        if waited_s > bound_s:
            self.violated(
                "L1",
                now_s,
                f"decided {waited_s:.2f} s after the COMMIT, the bound is {bound_s:.2f} s",
            )

    def _on_gap(self, role: Role, before: bool, now_s: float) -> None:
        """Check the gap from the sender's release until somebody is responsible again."""
        if self._claims.holders(now_s):
            if self._alone_s is not None:
                alone_s = now_s - self._alone_s
                self._alone_s = None
                self.gap_s = max(alone_s, self.gap_s or 0.0)
                bound_s = gap_bound_s(self.config)
                if alone_s > bound_s:
                    self.violated(
                        "L2",
                        now_s,
                        f"nobody was responsible for {alone_s:.2f} s, the bound is {bound_s:.2f} s",
                    )
        elif role is Role.SENDER and before:
            self._alone_s = now_s
