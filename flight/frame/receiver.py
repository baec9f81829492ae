"""D2's side of one attempt, put together once: its cycle over looks at the marker and at the
target.
"""

from __future__ import annotations

from collections.abc import Sequence

from drivers.interfaces import View
from flight.frame.records import Answer, AttemptId
from flight.frame.sender import PairCameras
from flight.rendezvous.marker_view import MarkerFix
from path.config import MethodConfig
from path.cycle.prior import Prior
from path.cycle.receiver import ReceiverCycle
from path.messages import Target, Vec3
from path.observations import Detection, Missed


class ReceiverSide:
    """D2 in one attempt.

    For each frame: a look at the marker with ``gravity_v``, ``prior``, a look for targets in its
    region, ``answer``. What D1 says goes to ``hear`` as it comes in.
    """

    def __init__(
        self,
        cameras: PairCameras,
        method: MethodConfig,
        attempt: AttemptId,
    ) -> None:
        x, y, z = cameras.T_v_c1.t.tolist()
        self._cycle = ReceiverCycle(
            cameras.receiver,
            method,
            **attempt._asdict(),
            sender=(cameras.sender, (x, y, z)),
        )

    def hear(
        self,
        target: Target,
        capture_ns: int,
        now_ns: int,
    ) -> Missed | None:
        """Take in a message of D1; None when it is used, else why not. Stamps are of D2's clock."""
        return self._cycle.on_target(target, capture_ns, now_ns)

    def gravity_v(self, stamp_ns: int) -> Vec3 | None:
        """Return gravity in the marker's frame at an instant of D2's clock.

        As D1 says; None when it does not.
        """
        return self._cycle.gravity_v(stamp_ns)

    def prior(self, fix: MarkerFix | Missed, stamp_ns: int) -> Prior | Missed:
        """Return where the target is expected in D2's frame of this stamp.

        By the marker's pose in that frame.
        """
        if isinstance(fix, Missed):
            return fix
        return self._cycle.prior(fix.T_c_v, fix.covariance, stamp_ns)

    def look(self, view: View, prior: Prior | Missed) -> Answer | None:
        """Look for the target where it is expected, and answer."""
        found = view.targets(prior.region) if isinstance(prior, Prior) else ()
        return self.answer(view.frame_id, view.stamp_ns, found, prior)

    def answer(
        self,
        frame_id: int,
        stamp_ns: int,
        found: Sequence[Detection],
        prior: Prior | Missed,
    ) -> Answer | None:
        """Return the answer to send; a miss, with its reason, is one too.

        None for a frame that is old or was answered.

        Args:
            frame_id: strictly increasing.
            stamp_ns: mid-exposure, D2's clock.
            found: by D2's own detector in ``prior.region``; empty without a prior.
            prior: of this frame, or why there is none.
        """
        candidate = self._cycle.candidate(frame_id, stamp_ns, found, prior)
        if isinstance(candidate, Missed):
            return None
        return Answer(candidate, prior, found)
