"""D1's side of one attempt, put together once: its cycle over frames as they are tracked, and what
is logged of it.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Self

from drivers.rig.parts import Rig
from flight.frame.records import AttemptId, OwnFrame, agreement_record
from flight.tracking.association import Sighting
from path.camera.model import CameraModel
from path.config import MethodConfig
from path.cycle.sender import PairVerdict, SenderCycle
from path.gate.window import Gate
from path.geometry.transforms import Pose
from path.messages import Candidate, Vec3
from path.observations import Missed, MissReason


class PairCameras(NamedTuple):
    """Both drones' cameras, and the place of D1's in the frame of its marker."""

    sender: CameraModel
    receiver: CameraModel
    T_v_c1: Pose

    @classmethod
    def of(cls, rig: Rig) -> Self:
        return cls(rig.sender.camera, rig.receiver.camera, rig.sender.mount.T_v_c)


class SenderSide:
    """D1 in one attempt.

    For each frame: ``observe``, its message goes out, then ``judge``. What D2 answers goes to
    ``hear`` as it comes in.
    """

    def __init__(
        self,
        cameras: PairCameras,
        method: MethodConfig,
        attempt: AttemptId,
        gate: Gate | None = None,
    ) -> None:
        """``gate``: what decides, when it is not to be the one that ``method`` names."""
        self._needed_pairs = method.needed_pairs
        self._target_id = attempt.target_id
        self._cycle = SenderCycle(*cameras, method, **attempt._asdict(), gate=gate)

    @property
    def gate(self) -> Gate:
        return self._cycle.gate

    def observe(
        self,
        frame_id: int,
        stamp_ns: int,
        seen: Sighting | MissReason,
        gravity_v: Vec3,
    ) -> OwnFrame:
        """Take in D1's newest frame.

        Args:
            frame_id: strictly increasing.
            stamp_ns: mid-exposure, D1's clock.
            seen: the target in it, as it was tracked, or why it was not seen.
            gravity_v: unit vector of gravity in the marker's frame at that instant.
        """
        if isinstance(seen, Sighting):
            message = self._cycle.observe(
                frame_id,
                stamp_ns,
                seen.box,
                seen.depth,
                gravity_v,
                seen.beside,
            )
        else:
            message = self._cycle.observe(frame_id, stamp_ns, None, None, gravity_v)
        return OwnFrame(frame_id, stamp_ns, seen, message)

    def hear(
        self,
        candidate: Candidate,
        capture_ns: int,
        now_ns: int,
    ) -> Missed | None:
        """Take in an answer of D2, and return why it is not judged; None when it will be.

        Stamps are of D1's clock.
        """
        return self._cycle.offer(candidate, capture_ns, now_ns)

    def judge(self, now_ns: int) -> list[PairVerdict]:
        """Return the verdicts on answers that D1's frames have passed, or that waited too long."""
        return self._cycle.evaluate_ready(now_ns)

    def begin_evidence_anew(self, stamp_ns: int) -> None:
        """Add nothing up across this instant of D1's clock.

        Either drone's reckoning was interrupted there.
        """
        self._cycle.begin_evidence_anew(stamp_ns)

    def record(self, pair: PairVerdict) -> dict[str, Any]:
        """Return ``/agreement`` of a verdict, with the count and evidence as they are now."""
        return agreement_record(pair, self.gate, self._needed_pairs, self._target_id)
