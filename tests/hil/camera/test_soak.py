"""The soak of the camera driver says what it measured, and notices memory that grows."""

from __future__ import annotations

import asyncio
from dataclasses import replace

from tests.hil.camera.driver_soak import FLAT_MIB, soak


def test_a_short_soak() -> None:
    report = asyncio.run(soak(60, (96, 72)))
    assert report.frames >= 60
    assert 0.0 < report.settled_mib <= report.peak_mib
    assert min(report.feed_ms, report.stream_ms, report.copy_ms, report.register_ms) > 0.0
    assert not replace(report, peak_mib=report.settled_mib + FLAT_MIB).flat
