"""The kernel's stamps of packets: they begin a moment after the first socket on a computer asks for
them.
"""

from __future__ import annotations

import time

from hil.vehicle.arrival import bound, packets

WAITED_S = 0.002


def wait_for_stamps() -> None:
    """Waits until packets are stamped when they come. Until then they are when they are read.

    They stay so as long as whoever asked for them has its socket open.
    """
    probe = bound(("127.0.0.1", 0))
    with probe:
        for _ in range(1000):
            probe.sendto(b"", probe.getsockname())
            sent_s = time.monotonic()
            time.sleep(WAITED_S)
            ((_, _, arrival_s),) = packets(probe)
            if arrival_s < sent_s + WAITED_S / 2:
                return
    raise OSError("the kernel does not stamp packets")
