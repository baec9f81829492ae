"""The programs of both roles, with what their missions do to the protocol scripted."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, cast

from drivers.interfaces import Received
from flight.outcome import Outcome
from missions.fly.leg.handover import ReceiverHandover, SenderHandover
from missions.proofs.campaign.program import OTHER_ID, Program
from path.messages import Candidate, Role, Target
from path.observations import MissReason
from path.protocol.values import HandoffOutcome as Decision

FRAME_S = 0.25
ATTEMPTS = 3
FREE_S = 5.0  # a sender that begins anew waits as long for the receiver to hold nothing
DOWN = (0.0, 0.0, 1.0)
UPRIGHT = (1.0, 0.0, 0.0, 0.0)


class _AsWritten:
    """Goes on when the session says that a record is on the disk."""

    _session: Any

    def _when_written(self, saved: Future[None], go_on: Callable[[], None]) -> Any:
        self._session.when_written(saved, go_on)
        return True


class _Sender(_AsWritten, SenderHandover): ...


class _Receiver(_AsWritten, ReceiverHandover): ...


class SenderProgram(Program):
    """D1: offers, has its script agree, decides, verifies again after taking back."""

    role = Role.SENDER

    def _boot(self) -> None:
        self.handover: SenderHandover = _Sender(cast(Any, self), cast(Any, self))
        self._first_s: float | None = None
        self._attempts = 0
        self._lied = False
        self._again = self._settling

    def _course(self) -> None:
        if not self._settle():
            return
        if not self._attempts:
            free = not self._again or self.handover.peer_is_free
            if free and self.world.now_s - self.began_s >= self.world.plan.offer_s:
                self._attempt(self.handover.begin_offer)
                self.observing = True
            elif self.world.now_s - self.began_s > FREE_S:
                self.end_mission(Outcome.PEER_ABORTED)
        elif self.decision is Decision.TAKEN_BACK and self._attempts < ATTEMPTS:
            self.decision = None
            self._attempt(self.handover.verify_again)
        elif self.decision is Decision.HANDED_OVER:
            if self.settled is not None:
                held = self.settled is Decision.HANDED_OVER
                self.end_mission(Outcome.COMMITTED if held else Outcome.ORPHANED)
        elif self.decision is not None:
            self.end_mission(_END.get(self.decision, Outcome.PEER_ABORTED))
        elif self._first_s is not None and not self.handover.released and self._silent():
            self.end_mission(Outcome.PEER_LOST)

    def _attempt(self, begin: Callable[[], None]) -> None:
        self._attempts += 1
        self._first_s = None
        self._lied = False
        self.world.judge.begun()
        begin()

    def _frame(self) -> float:
        """Say where the target is, and has the views agree when the script wants them to."""
        epoch = self.handover.epoch
        script = self.world.plan
        if not epoch or self.end is not None:
            return FRAME_S
        config = self.config
        self.send(
            Target(config.handoff_id, epoch, config.target_id, 0, self.now_ns(), DOWN, DOWN, 0.01)
        )
        if self._first_s is None or script.agree_s is None or self.handover.released:
            return FRAME_S
        seen_s = self.world.now_s - self._first_s
        if script.wrong and not self._lied and seen_s > 0.5 * script.agree_s:
            self._lied = True
            self.handover.agreed(OTHER_ID)
        if seen_s >= script.agree_s:
            self.world.judge.agreed(epoch)
            self.handover.agreed(config.target_id)
        return FRAME_S

    def _on_message(self, received: Received) -> None:
        message = received.message
        if (
            isinstance(message, Candidate)
            and message.epoch == self.handover.epoch
            and self._first_s is None
        ):
            self._first_s = self.world.now_s
        self.handover.on_message(received)


class ReceiverProgram(Program):
    """D2: answers every Target, and holds what it is given."""

    role = Role.RECEIVER

    def _boot(self) -> None:
        self.handover: ReceiverHandover = _Receiver(cast(Any, self), cast(Any, self), self._able)
        self.observing = True

    def _able(self) -> bool:
        blind = self.world.plan.blind
        return blind is None or not blind[0] <= self.world.now_s <= blind[1]

    def _course(self) -> None:
        if not self._settle() or (self.decision is None and self.handover.holds):
            return
        match self.decision:
            case None:
                if self.handover.live is not None and self._silent():
                    self.end_mission(Outcome.PEER_LOST)
            case Decision.HANDED_OVER:
                pass
            case Decision.LET_GO:
                if self.settled is Decision.TAKEN_BACK:
                    self.decision = self.settled = None
                elif self.settled is not None:
                    self.end_mission(Outcome.ORPHANED)
            case Decision.SUPERSEDED:
                self.decision = None
            case _:
                self.end_mission(_END.get(self.decision, Outcome.PEER_ABORTED))

    def _frame(self) -> float:
        return 10.0 * FRAME_S  # it answers

    def _on_message(self, received: Received) -> None:
        message = received.message
        handover = self.handover
        handover.on_message(received)
        live = handover.live
        if (
            isinstance(message, Target)
            and live is not None
            and self.end is None
            and not handover.holds
        ):
            bound = (live.handoff_id, live.epoch, live.target_id)
            missed = (None, MissReason.NO_CANDIDATE)
            self.send(
                Candidate(*bound, 0, message.sequence, self.now_ns(), *missed, DOWN, UPRIGHT, 0.01)
            )


_END = {Decision.TIMEOUT: Outcome.NO_AGREEMENT}
