"""Holds one run of the machines to S1-S6, L1 and L2: from true time and from what the programs do,
not what they say.

A clock that was set, and a disk that has lost what it said that it has, are outside what the leases
and epochs assume (``flight.clocks`` finds the first, and ends the mission): what breaks after
either is kept apart, as ``beyond``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from missions.proofs.campaign.program import MISSION, OTHER_ID, Program
from missions.proofs.verify.rules import lowest_epoch, used_epoch
from path.messages import Accept, Commit, Message, Ping, Role
from path.protocol import receiver, sender
from path.protocol.bounds import LATE_S, commit_bound_s, decision_bound_s, gap_bound_s
from path.protocol.values import (
    Handoff,
    HandoffOutcome,
    ProtocolConfig,
    ReceiverRecord,
    SenderRecord,
)

if TYPE_CHECKING:
    from missions.proofs.campaign.machines import Machines

DEADLINES = MISSION.deadlines
CONFIG = ProtocolConfig(
    offer_s=DEADLINES.receiver_ready_s + DEADLINES.verify_s,
    handoff_s=DEADLINES.receiver_ready_s + 2 * DEADLINES.verify_s,
)  # as ``missions.fly.leg.handover.protocol_config`` makes it of the mission
DRIFT = 1.0 + 1e-3
COMMIT_BOUND_S = commit_bound_s(CONFIG)
DECISION_BOUND_S = decision_bound_s(CONFIG)
GAP_BOUND_S = gap_bound_s(CONFIG)
LOOK_EVERY = 8  # events
SURE_S = 1e-6  # two instants that are the same


@dataclass(slots=True)
class _Issued:
    """A COMMIT that was really given, in true time."""

    handoff: Handoff
    end_s: float


class Judge:
    """Watches one run."""

    def __init__(self, world: Machines) -> None:
        self._world = world
        self.violations: list[str] = []
        self.beyond: list[str] = []
        self.decided_s = self.gap_s = 0.0
        self.commit_s: float | None = None
        self.broken: list[str] = []  # assumptions
        self._stalled_s = 0.0
        self._agreed: set[int] = set()
        self._issued: dict[tuple[int, int], _Issued] = {}  # by epoch and nonce
        self._committed_s: float | None = None
        self._accepted: set[int] = set()  # epochs in which the sender was given an ACCEPT
        self._epochs: set[int] = set()  # of the sender's attempts
        # when one was begun that is not on the disk yet: nothing is said in it
        self._begun_s: float | None = None
        self._highest = {Role.SENDER: 0, Role.RECEIVER: 0}
        self._since: dict[Role, tuple[int, float] | None] = {Role.SENDER: None, Role.RECEIVER: None}
        self._ends: dict[Role, list[tuple[HandoffOutcome, str | None]]] = {
            Role.SENDER: [],
            Role.RECEIVER: [],
        }
        self._alone_s: float | None = None
        self._anew = False
        self._told: set[str] = set()
        self._events = 0
        self._seen: dict[Role, Any] = {Role.SENDER: None, Role.RECEIVER: None}
        self._orphaned = self._committed = False

    # --- told by the programs

    def clock_set(self) -> None:
        self._break("clock")

    def forgot(self) -> None:
        self._break("disk")

    def _break(self, assumption: str) -> None:
        if assumption not in self.broken:
            self.broken.append(assumption)

    def stalled(self, for_s: float) -> None:
        """A program stands still: all that is to end in time may end as much later."""
        self._stalled_s += for_s

    def agreed(self, epoch: int) -> None:
        self._agreed.add(epoch)

    def begun(self) -> None:
        """The sender begins an attempt."""
        self._begun_s = self._world.now_s

    def anew(self, program: Program) -> None:
        """Notes that a new mission begins on the ground: what was held or given away is over."""
        self._anew = True
        self._since[program.role] = None

    def died(self, program: Program) -> None:
        self._since[program.role] = None
        if program.role is Role.SENDER:
            self._committed_s = self._begun_s = None
        self._gap()

    def kept(self, program: Program, record: SenderRecord | ReceiverRecord) -> None:
        """S2, on disk."""
        if record.epoch < self._highest[program.role]:
            self._violated(
                "S2", f"the {program.role.value} wrote epoch {record.epoch} down after a higher one"
            )
        self._highest[program.role] = max(self._highest[program.role], record.epoch)
        if record.duty == "handed_over":
            self._accepted.add(record.epoch)

    def sent(self, program: Program, message: Message) -> None:
        world = self._world
        if not isinstance(message, Commit):
            return
        if program.responsible:
            self._violated("S4", "COMMIT before the release")
        if message.epoch not in self._agreed or message.target_id == OTHER_ID:
            self._violated(
                "S5",
                f"COMMIT to target {message.target_id} in epoch {message.epoch} without agreement",
            )
        end_s = world.now_s + (message.lease_end_ns - program.now_ns()) * 1e-9 / program.clock.rate
        handoff = Handoff(message.handoff_id, message.epoch, message.target_id, message.instance)
        self._issued.setdefault((message.epoch, message.nonce), _Issued(handoff, end_s))
        if self._committed_s is None:
            self._committed_s = world.now_s

    def claimed(self, program: Program) -> None:
        world = self._world
        if not program.responsible:
            return
        other = world.program(Role.RECEIVER if program.role is Role.SENDER else Role.SENDER)
        if other is not None and other.responsible:
            self._violated("S1", "two responsible drones")
        if not program.booted:
            return
        state = program.handover.state
        if program.role is Role.SENDER:
            self._took_back(state)
        elif program.claim is not None and program.claim.provisional:
            self._took_over(state)

    def _took_back(self, state: Any) -> None:
        if not isinstance(state, sender.TakenBack):
            return
        given = [
            issued for (epoch, _), issued in self._issued.items() if epoch == state.live.epoch - 1
        ]
        if given and self._world.now_s < given[0].end_s - SURE_S:
            self._violated("S4", "taken back before the lease's end")
        if state.live.epoch - 1 in self._accepted:
            self._violated("S4", "taken back after an ACCEPT")

    def _took_over(self, state: Any) -> None:
        issued = (
            self._issued.get((state.live.epoch, state.nonce))
            if isinstance(state, receiver.Provisional)
            else None
        )
        if issued is None or issued.handoff != state.live:
            self._violated("S3", "taken over without a COMMIT that was given")
        elif self._world.now_s > issued.end_s + SURE_S:
            self._violated(
                "S3", f"taken over {self._world.now_s - issued.end_s:.3f} s after the lease's end"
            )
        elif state.live.epoch < self._highest[Role.SENDER]:
            self._violated("S2", "taken over in an epoch that is past")

    def decided(self, program: Program, outcome: HandoffOutcome, reason: str | None) -> None:
        role = program.role
        now_s = self._world.now_s
        self._ends[role].append((outcome, reason))
        began = self._since[role]
        self._since[role] = None
        if began is not None:
            waited_s = now_s - began[1]
            self.decided_s = max(self.decided_s, waited_s)
            if waited_s > DECISION_BOUND_S * DRIFT + self._stalled_s:
                self._violated("L1", f"the {role.value} decided after {waited_s:.2f} s")
        if role is Role.SENDER and self._committed_s is not None:
            self.commit_s = max(self.commit_s or 0.0, now_s - self._committed_s)
            self._committed_s = None

    def taken(self, program: Program, kind: str, message: Message) -> None:
        """S6: a packet was taken for a message of the other drone's. A ping moves nothing, be it a
        recorded one.
        """
        if kind != "genuine" and not isinstance(message, Ping):
            self._violated(
                "S6", f"a {kind} {type(message).__name__} was taken by the {program.role.value}"
            )

    def heard(self, program: Program, before: Any, message: Message) -> None:
        """S4: an ACCEPT of what was committed, and not withdrawn, hands over."""
        if (
            isinstance(message, Accept)
            and isinstance(before, sender.AwaitingAccept)
            and before.withdrawn is None
        ):
            same = (message.epoch, message.nonce) == (before.live.epoch, before.commit.nonce)
            if same and program.now_ns() < before.take_back_ns and not program.handover.handed_over:
                self._violated("S4", "an ACCEPT in time that did not hand over")

    # --- after every event

    def after(self, program: Program) -> None:
        if not program.alive or not program.booted:
            return
        role: Role = program.role
        state: Any = program.handover.carried_out
        self._events += 1
        if state is self._seen[role] and self._events % LOOK_EVERY:
            return  # of an event that changed nothing only time is left to judge, now and then
        self._seen[role] = state
        self._begins(role, state)
        epoch = used_epoch(state) if role is Role.SENDER else lowest_epoch(state)
        if epoch < self._highest[role]:
            self._violated(
                "S2", f"the {role.value} is in epoch {epoch}, after {self._highest[role]}"
            )
        if program.writing is None and not _is_what_it_says(program, state):
            self._violated("S1", f"the {role.value} is not what its machine is")
        self._overdue(program, state)
        self._gap()

    def _begins(self, role: Role, state: Any) -> None:
        """An attempt is one once it is on the disk. S2: each has an epoch of its own."""
        if role is Role.SENDER:
            if self._begun_s is None or not isinstance(state, sender.Offering | sender.Verifying):
                return
            epoch = state.live.epoch
            last = max(self._epochs, default=0)
            if epoch <= last:
                self._violated("S2", f"an attempt in epoch {epoch}, after {last}")
            self._epochs.add(epoch)
            self._since[role] = (epoch, self._begun_s)
            self._begun_s = None
            self._anew = False
        elif isinstance(state, receiver.Observing) and state.live is not None:
            since = self._since[role]
            if since is None or since[0] != state.live.epoch:
                self._since[role] = (state.live.epoch, self._world.now_s)

    def _overdue(self, program: Program, state: Any) -> None:
        """L1: everything that waits, ends."""
        match state:
            case sender.Offering() | sender.Verifying():
                end_ns = state.end_ns
            case sender.AwaitingAccept():
                end_ns = state.take_back_ns
            case sender.HandedOver(settled=None) | receiver.LetGo(settled=None):
                end_ns = state.settle_end_ns
            case receiver.Provisional():
                end_ns = state.lease_end_ns
            case _:
                return
        late_s = min((program.now_ns() - end_ns) * 1e-9, self._world.now_s - program.began_s)
        if late_s > LATE_S + self._stalled_s:
            self._violated("L1", f"{type(state).__name__} is {late_s:.2f} s overdue")

    def _gap(self) -> None:
        """Check L2: nobody is responsible, though whoever would have to be runs.

        As ``missions.proofs.verify.moves`` has it.
        """
        gives = self._world.state(Role.SENDER)
        takes = self._world.state(Role.RECEIVER)
        if not self._nobody(gives, takes):
            self._close_gap()
            return
        now_s = self._world.now_s
        if self._alone_s is None:
            self._alone_s = now_s
        elif (
            now_s - self._alone_s > GAP_BOUND_S * DRIFT + self._stalled_s
            and not _orphan(gives, takes)
            and not self._anew
        ):
            self._violated(
                "L2", f"nobody is responsible: {type(gives).__name__}, {type(takes).__name__}"
            )
        if _orphan(gives, takes):
            self._orphaned = True
            if takes.settled is HandoffOutcome.TAKEN_BACK:
                self._violated("L2", "an orphan that the receiver takes for well")

    def _nobody(self, gives: Any, takes: Any) -> bool:
        if gives is None or sender.is_responsible(gives):
            return False
        # before its first offer, or landed: of what it once had there is no word
        if isinstance(gives, sender.Idle):
            return bool(self._epochs) and not self._anew
        program = self._world.program(Role.RECEIVER)
        if takes is None or program is None:
            return not isinstance(gives, sender.HandedOver)
        return not receiver.is_responsible(takes, program.now_ns())

    def _close_gap(self) -> None:
        if self._alone_s is not None and not self._orphaned and not self._anew:
            self.gap_s = max(self.gap_s, self._world.now_s - self._alone_s)
        self._alone_s = None

    def close(self) -> None:
        """The run is over: nothing may still be undecided."""
        if self._world.now_s >= 44.0:
            self._violated("L1", "still undecided at the end of the run")
        self._close_gap()

    # --- outcome

    def outcome(self) -> str:
        """Return the end of the run, by what both sides decided."""
        gave = [end for end in self._ends[Role.SENDER] if end[0] is HandoffOutcome.HANDED_OVER]
        held = any(
            outcome is HandoffOutcome.HANDED_OVER for outcome, _ in self._ends[Role.RECEIVER]
        )
        takes = self._world.state(Role.RECEIVER)
        if held or (gave and isinstance(takes, receiver.Holding)):
            return "commit"
        if gave:
            return (
                "orphaned"
                if self._orphaned or isinstance(takes, receiver.LetGo)
                else "handed over, receiver dead"
            )
        ends = self._ends[Role.SENDER] or self._ends[Role.RECEIVER]
        if ends:
            outcome, reason = ends[-1]
            if outcome is HandoffOutcome.ABORTED:
                return f"aborted: {reason}"
            return outcome.value.replace("_", " ")
        program = self._world.program(Role.SENDER)
        end = program.end if program is not None else None
        return end.outcome.label.replace("_", " ") if end is not None else "no offer"

    def _violated(self, name: str, what: str) -> None:
        text = f"{name} at {self._world.now_s:.3f} s: {what}"
        if f"{name} {what[:20]}" in self._told:  # once is enough
            return
        self._told.add(f"{name} {what[:20]}")
        (self.beyond if self.broken else self.violations).append(text)
        self._world.tell(Role.SENDER, f"*** {text}")


def _orphan(gives: Any, takes: Any) -> bool:
    """The one state that may leave nobody responsible."""
    return isinstance(gives, sender.HandedOver) and isinstance(takes, receiver.LetGo)


def _is_what_it_says(program: Program, state: Any) -> bool:
    """Return whether a program's responsibility is its machine's.

    A sender that starts again on the ground tracks nothing.
    """
    if program.role is Role.SENDER:
        if program.responsible == sender.is_responsible(state):
            return True
        return (
            not program.responsible
            and isinstance(state, sender.Keeping)
            and not program.vehicle.state.armed
        )
    return program.responsible == receiver.is_responsible(state, program.now_ns())
