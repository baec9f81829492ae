"""The last few seconds of a vehicle's attitude, to ask for the one at the instant a frame was
taken.
"""

from __future__ import annotations

import threading
from bisect import bisect_left

from drivers.interfaces import VehicleError
from path.geometry.rotation import slerp
from path.messages import Quat


class StateHistory:
    """Attitudes by role-clock stamp, oldest first; one thread may add while another asks.

    Keeps at least the newest ``capacity`` attitudes (512 are ten seconds at 50 Hz).
    """

    def __init__(self, capacity: int = 512) -> None:
        if capacity < 2:
            raise ValueError("a history needs room for two attitudes")
        self._capacity = capacity
        self._stamps: list[int] = []
        self._attitudes: list[Quat] = []
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return min(len(self._stamps), self._capacity)

    def add(self, stamp_ns: int, q_n_b: Quat) -> bool:
        """Append an attitude (unit, wxyz). False, and not kept, when it is not newer than the
        newest.
        """
        with self._lock:
            if self._stamps and stamp_ns <= self._stamps[-1]:
                return False
            self._stamps.append(stamp_ns)
            self._attitudes.append(q_n_b)
            if len(self._stamps) >= 2 * self._capacity:  # forget in blocks: O(1) for each attitude
                del self._stamps[: -self._capacity]
                del self._attitudes[: -self._capacity]
            return True

    def attitude_at(self, stamp_ns: int) -> Quat:
        """Attitude at a stamp, on the shorter arc between its neighbours; the nearest one when out
        of range.

        Raises VehicleError when nothing was added yet.
        """
        with self._lock:
            if not self._stamps:
                raise VehicleError(
                    "no attitude of the vehicle is known yet", "enter it with `async with` first"
                )
            after = bisect_left(self._stamps, stamp_ns)
            if after == 0:
                return self._attitudes[0]
            if after == len(self._stamps):
                return self._attitudes[-1]
            t0 = self._stamps[after - 1]
            t1 = self._stamps[after]
            q0 = self._attitudes[after - 1]
            q1 = self._attitudes[after]
        return slerp(q0, q1, (stamp_ns - t0) / (t1 - t0))
