"""The test of the guard's own link, over real sockets to the embedded vehicle."""

from __future__ import annotations

import pytest

from missions.field.doctor import guard as doctor_guard
from missions.field.doctor.guard import check_guard
from tests.drivers.mavlink.test_guard_link import guard_at
from tests.free_ports import free_port
from tests.guard_bench import bench
from tests.missions.field.doctor.doctor_findings import found


def test_a_guard_that_hears_its_vehicle_is_well() -> None:
    with bench() as own:
        every = found(check_guard(guard_at(f"udpin://127.0.0.1:{own.port}")))
    assert every["hears"].state == "ok"
    assert "position too" in every["hears"].detail


def test_silence_on_its_link_is_a_fault_with_its_fix(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor_guard, "WAIT_S", 0.1)
    every = found(check_guard(guard_at(f"udpin://127.0.0.1:{free_port()}")))
    assert every["hears"].state == "fault"
    assert "no heartbeat" in every["hears"].detail
    assert "a link of its own" in every["hears"].fix
