"""The rate at which a stream brings something new."""

from __future__ import annotations

import asyncio

import pytest

from drivers.rig import part_check
from drivers.rig.part_check import counted, examined, rate_finding
from hil.harness.virtual_time import run_virtual


@pytest.mark.parametrize(("hz", "state"), [(50.0, "ok"), (40.0, "note"), (20.0, "fault")])
def test_a_stream_slower_than_asked_for_is_told_with_the_fix(hz: float, state: str) -> None:
    finding = rate_finding("attitude", hz, 50.0, "a faster link")
    assert finding.state == state
    assert finding.fix == ("" if state == "ok" else "a faster link")


def test_each_stamp_counts_once_and_a_silent_stream_not_at_all(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(part_check, "COUNT_S", 0.3)

    async def main() -> None:
        loop = asyncio.get_running_loop()
        ticks = {"ticking": lambda: int(loop.time() * 20.0), "silent": lambda: None}
        ticking, silent = await counted(ticks, 20.0, "")
        assert 10.0 < float(ticking.detail.split()[0]) < 30.0
        assert silent.state == "fault"
        assert silent.detail.startswith("0.0 of 20")

    run_virtual(main())


def test_a_part_without_an_own_test_says_nothing() -> None:
    assert asyncio.run(examined(object())) == ()
