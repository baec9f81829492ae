"""A session with beacons: the same table live and from its record, and a clock that was set wrong
is found out.
"""

from __future__ import annotations

import io
import json
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.beacons.record import read_any
from drivers.interfaces import BeaconError, PartError
from drivers.log.mcap_log import McapLog, read_log
from drivers.rig.parts import PartSpec
from hil.beacons.noise import BeaconConfig
from hil.beacons.pty import BeaconThread, SerialCable
from hil.beacons.system import BeaconSystem
from missions.ground import rig_library
from missions.ground.options.proofs import TrialOptions
from missions.ground.work import open_work
from missions.trials.flights.beacon import trial as beacon
from missions.trials.flights.beacon.session import Listener, load_session
from missions.trials.flights.beacon.trial import FLOWN
from missions.trials.run import plain
from missions.trials.run import run as run_trial
from missions.trials.shared.trial import TrialRequest, TrialResult
from tests.drivers.beacons.beacon_log import write_beacons

SHIFT_NS = 300_000_000
UNIX_MS = 1_763_898_305_000


# agreement is held for 8 s, not for the 28 of the rig: what is measured needs no more
BRIEF = """like = "dynamic"
[method]
hold_frames = 400
hold_s = 8.0
"""


@dataclass(frozen=True, slots=True)
class FlownSession:
    """A session that the command flew: the rig, the folder of the trial, that of the session, and
    the trial's summary.
    """

    rig: Path
    out: Path
    folder: Path
    summary: dict[str, Any]


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> FlownSession:
    rig = tmp_path_factory.mktemp("rig") / "brief.toml"
    rig.write_text(BRIEF, "utf-8")
    out = tmp_path_factory.mktemp("live")
    assert run_trial(TrialOptions("beacon", rig=str(rig), seed=3, quick=True, jobs=1, out=out)) == 0
    summary = json.loads((out / "summary.json").read_text("utf-8"))
    return FlownSession(rig, out, out / FLOWN, summary)


def judged(live: FlownSession, out: Path, logs: Path) -> TrialResult:
    out.mkdir(exist_ok=True)
    rig = rig_library.load(str(live.rig))
    with open_work(1, io.StringIO()) as work:
        return beacon.run(TrialRequest(rig, out, 3, True, work, logs=logs))


def session(folder: Path, flown: Path, beacons: str = "beacons.mcap") -> Path:
    """The folder of a session with the logs of another, for other beacons."""
    folder.mkdir()
    for name in (
        "sender.mcap",
        "receiver.mcap",
        "run.json",
        "world.mcap",
        "beacons.truth.json",
        beacons,
    ):
        if (flown / name).exists():
            (folder / name).symlink_to(flown / name)
    return folder


def test_a_record_gives_the_same_table_as_live(live: FlownSession, tmp_path: Path) -> None:
    """Byte for byte, though the bytes of the ports had cut, damaged and late frames in them."""
    again = judged(live, tmp_path / "again", live.folder)
    assert (tmp_path / "again" / "errors.csv").read_bytes() == (
        live.out / "errors.csv"
    ).read_bytes()
    assert {name: live.summary[name] for name in again.summary} == plain(again.summary)


def test_the_table_has_both_trajectories_by_phase_with_intervals(live: FlownSession) -> None:
    rows = live.summary["errors"]
    assert {row["subject"] for row in rows} == {"d2", "target"}
    assert {"all", "verify"} <= {row["segment"] for row in rows}
    for row in rows:
        low, high = row["rmse_interval_m"]
        # one block: all three are one number
        assert low * (1.0 - 1e-12) <= row["rmse_m"] <= high * (1.0 + 1e-12)
        assert 0.02 < row["rmse_m"] < 0.1  # two beacons of 2 cm each
    assert all(
        (live.out / picture).stat().st_size > 10_000 for picture in ("map.png", "errors.png")
    )


def test_a_listener_whose_clock_is_wrong_by_0_3_s_is_found_out(
    live: FlownSession, tmp_path: Path
) -> None:
    """To 10 ms: the very bytes, with other stamps of arrival."""
    flown, summary = live.folder, live.summary
    folder = session(tmp_path / "late", flown, beacons="none")
    with McapLog(folder / "beacons.mcap") as log:
        for record in read_log(flown / "beacons.mcap"):
            log.write(record.topic, record.stamp_ns + SHIFT_NS, record.record)
    late = judged(live, tmp_path / "out", folder)
    assert summary["time_offset_s"] - late.summary["time_offset_s"] == pytest.approx(0.3, abs=0.01)
    # this flight, against the harness's own clock
    assert abs(late.summary["time_offset_error_s"] + 0.3) < 0.02
    rms = [
        {row["subject"]: row["rmse_m"] for row in each["errors"]}
        for each in (summary, late.summary)
    ]
    assert rms[1] == pytest.approx(rms[0], rel=0.02)


def test_a_list_of_positions_is_judged_without_truth(live: FlownSession, tmp_path: Path) -> None:
    """As in the field: nobody knows better."""
    folder = tmp_path / "field"
    folder.mkdir()
    for name in ("sender.mcap", "receiver.mcap"):
        (folder / name).symlink_to(live.folder / name)
    fixes = read_any(live.folder / "beacons.mcap")
    write_beacons(
        folder / "beacons.csv",
        [replace(fix, stamp_ns=fix.host_ns or 0, host_ns=None) for fix in fixes],
    )
    found = judged(live, tmp_path / "out", folder)
    assert found.summary["time_offset_error_s"] is None
    assert found.summary["time_offset_s"] == pytest.approx(live.summary["time_offset_s"], abs=1e-3)
    assert found.noise is None


def test_a_session_may_have_the_dashboards_own_log(live: FlownSession, tmp_path: Path) -> None:
    """By another clock, in whole milliseconds, and without a rating of the positions."""
    folder = session(tmp_path / "dashboard", live.folder, beacons="none")
    heard = read_any(live.folder / "beacons.mcap")
    rows = (
        f"{UNIX_MS + (fix.host_ns or 0) // 1_000_000},20,900,{fix.address},{x:.3f},{y:.3f},{z:.3f},1,3.9,2,4.8\n"
        for fix in heard
        for x, y, z in [fix.position_m]
    )
    (folder / "beacons.csv").write_text(f"T2025_11_23__114505_120,1\n{''.join(rows)}", "utf-8")
    for read, was in zip(load_session(folder).fixes, heard, strict=True):
        assert (read.address, read.position_m) == (
            was.address,
            pytest.approx(was.position_m, abs=1e-9),
        )
        assert read.stamp_ns - UNIX_MS * 1_000_000 == pytest.approx(was.host_ns, abs=1_000_000)


def test_a_folder_that_is_no_session_is_refused(tmp_path: Path) -> None:
    with pytest.raises(
        PartError, match=r"sender.mcap, receiver.mcap, beacons.mcap or beacons.csv missing"
    ):
        load_session(tmp_path)


def test_records_that_have_nothing_in_common_are_refused(
    live: FlownSession, tmp_path: Path
) -> None:
    folder = session(tmp_path / "other", live.folder, beacons="none")
    write_beacons(folder / "beacons.csv", [])
    with pytest.raises(PartError, match="cannot be laid together"):
        judged(live, tmp_path / "out", folder)


def test_a_rig_without_beacons_is_refused() -> None:
    with pytest.raises(PartError, match=r"\[reference\]: missing table"):
        beacon.check(rig_library.load("sitl"))


def test_the_command_says_how_much_was_heard(live: FlownSession) -> None:
    assert live.summary["positions"] > 500


def test_a_listener_on_a_real_port_keeps_what_it_hears(tmp_path: Path) -> None:
    """Through pyserial, in real time, while something else clears the folder of logs as a flight
    does at its start.
    """
    cable = SerialCable(tmp_path / "hedge")
    cable.plug()
    rig = rig_library.load("dynamic")
    spec = PartSpec("drivers.beacons.marvelmind:Marvelmind", {"ports": [str(cable.link)]}, "test")
    system, seconds = (
        BeaconSystem(BeaconConfig(), 1, {"sender": 5, "receiver": 6, "target": 7}),
        time.monotonic,
    )
    thread = BeaconThread(system, lambda _: cable, seconds, lambda _: (seconds(), np.zeros(3)))
    with Listener(rig, spec, tmp_path / "beacons.mcap") as listener:
        for left in tmp_path.glob("*.mcap"):
            left.unlink()
        thread.start()
        end_s = seconds() + 60.0
        while len(listener.fixes) < 20 and seconds() < end_s:
            time.sleep(0.01)
        thread.end()
    cable.unplug()
    assert len(listener.fixes) >= 20
    assert repr(read_any(tmp_path / "beacons.mcap")) == repr(listener.fixes)
    late_ns = [(fix.host_ns or 0) - seconds() * 1e9 for fix in listener.fixes]
    assert max(late_ns) < 0.0


def test_beacons_that_stay_silent_are_named(tmp_path: Path) -> None:
    rig = rig_library.load("dynamic")
    spec = PartSpec(
        "drivers.beacons.marvelmind:Marvelmind", {"ports": [str(tmp_path / "none")]}, "test"
    )
    with (
        pytest.raises(BeaconError, match=r"serial port .*none"),
        Listener(rig, spec, tmp_path / "beacons.mcap"),
    ):
        pass
