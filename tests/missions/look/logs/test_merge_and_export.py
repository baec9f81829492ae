"""One log on one clock, trajectories and tables, from logs of computers that do not agree about the
time.
"""

from __future__ import annotations

import csv
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from drivers.interfaces import PartError
from drivers.log.mcap_log import McapLog, read_log
from missions.ground.options.runs import ExportOptions, MergeOptions
from missions.look.logs.export import run as run_export
from missions.look.logs.merge import run as run_merge
from missions.look.report.command import make_report
from tests.written_logs import until_written

HOUR_NS = 3_600_000_000_000
OFFSET_NS = 7_123_456_789  # the receiver's monotonic clock minus the sender's
ERROR_NS = 1_500_000  # of what it measured
EVENTS = 40


def write_logs(folder: Path, *, measured: bool = True) -> None:
    """The same instants on two computers, one of whose UTC is an hour off; each tells of both ends
    of the other's.
    """
    for name, stamps_ns, utc_ns in (
        ("sender", 0, 10 * HOUR_NS),
        ("receiver", OFFSET_NS, 11 * HOUR_NS - OFFSET_NS),
    ):
        with McapLog(folder / f"{name}.mcap", name, utc_minus_stamp_ns=utc_ns) as log:
            sign = -1 if name == "receiver" else 1
            for k in range(EVENTS):
                now_ns = k * 1_000_000_000 + stamps_ns
                offset_ns = sign * OFFSET_NS + ERROR_NS if measured else None
                link = {
                    "packets_sent": k,
                    "packets_received": k,
                    "bytes_sent": 0,
                    "bytes_received": 0,
                    "dropped": {},
                }
                clock = {
                    "clock_offset_ns": offset_ns,
                    "clock_uncertainty_ns": 2_000_000 if measured else None,
                }
                log.write("/link", now_ns, link | clock)
                log.write("/note", now_ns, {"note": str(k)})
            assert log.failed is None
    with McapLog(
        folder / "receiver.guard.mcap", "receiver", utc_minus_stamp_ns=11 * HOUR_NS - OFFSET_NS
    ) as log:
        log.write("/guard_stalled", 5_000_000_000 + OFFSET_NS, {"stalled_s": 1.0})


def notes(path: Path) -> dict[str, list[int]]:
    found: dict[str, list[int]] = {}
    with path.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages():
            found.setdefault(channel.topic, []).append(message.log_time)
    return found


def test_clocks_an_hour_apart_line_up_within_what_is_stated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_logs(tmp_path)
    assert run_merge(MergeOptions((tmp_path,))) == 0
    merged = notes(tmp_path / "merged.mcap")
    apart = np.array(merged["/receiver/note"]) - np.array(merged["/sender/note"])
    assert len(apart) == EVENTS
    assert np.abs(apart).max() <= 2_000_000
    assert abs(merged["/receiver_guard/guard_stalled"][0] - merged["/sender/note"][5]) <= 2_000_000
    said = capsys.readouterr().out
    assert "receiver: moved by -3599.99" in said
    assert "within 2.000 ms" in said
    assert run_merge(MergeOptions((tmp_path,))) == 0  # again: what it made is not taken for a log
    assert set(notes(tmp_path / "merged.mcap")) == set(merged)


def test_clocks_that_were_never_compared_are_left_and_that_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_logs(tmp_path, measured=False)
    files = (tmp_path / "sender.mcap", tmp_path / "receiver.mcap")
    assert run_merge(MergeOptions(files, tmp_path / "one.mcap")) == 0
    assert "receiver: its UTC as it is" in capsys.readouterr().out
    merged = notes(tmp_path / "one.mcap")
    assert set(np.array(merged["/receiver/note"]) - np.array(merged["/sender/note"])) == {HOUR_NS}


def test_a_log_that_was_cut_off_merges_up_to_there(tmp_path: Path) -> None:
    with McapLog(tmp_path / "sender.mcap", "sender", utc_minus_stamp_ns=0) as log:
        for k in range(30):
            log.write("/note", k, {"note": "x" * 30})
        until_written(log)
        killed = (tmp_path / "sender.mcap").read_bytes()
    (tmp_path / "sender.mcap").write_bytes(killed[: len(killed) * 2 // 3])
    run_merge(MergeOptions((tmp_path,)))
    assert 5 < len(notes(tmp_path / "merged.mcap")["/sender/note"]) < 30


def test_where_there_is_no_log_that_is_said(tmp_path: Path) -> None:
    with pytest.raises(PartError, match="no log"):
        run_merge(MergeOptions((tmp_path,)))


def test_trajectories_differ_from_the_truth_by_what_the_report_prints(
    make_run: Callable[..., Path], tmp_path: Path
) -> None:
    folder = make_run(d2_error_m=0.03)
    with (tmp_path / "said.txt").open("w") as stream:
        summary = make_report(folder, False, stream)
    assert run_export(ExportOptions(folder, tum=True)) == 0
    measured, true = (
        np.loadtxt(folder / "export" / f"{name}.tum") for name in ("marker", "truth-marker")
    )
    assert (measured[:, 0] == true[:, 0]).all()
    errors = np.linalg.norm(measured[:, 1:4] - true[:, 1:4], axis=1)
    assert np.median(errors) == pytest.approx(summary["d2_error_m"], abs=2e-4)
    assert np.linalg.norm(measured[:, 4:], axis=1) == pytest.approx(1.0)


def test_evo_says_what_the_report_prints(make_run: Callable[..., Path], tmp_path: Path) -> None:
    folder = make_run(d2_error_m=0.03)
    with (tmp_path / "said.txt").open("w") as stream:
        summary = make_report(folder, False, stream)
    assert run_export(ExportOptions(folder, tum=True)) == 0
    files = [str(folder / "export" / f"{name}.tum") for name in ("truth-marker", "marker")]
    evo = [str(Path(sys.executable).with_name("evo_ape")), "tum", *files]
    done = subprocess.run(
        evo,
        capture_output=True,
        text=True,
        timeout=600.0,
        env={**os.environ, "HOME": str(tmp_path)},
        check=False,
    )
    assert done.returncode == 0, done.stderr
    (median,) = (
        float(line.split()[1])
        for line in done.stdout.splitlines()
        if line.split()[:1] == ["median"]
    )
    assert median == pytest.approx(summary["d2_error_m"], abs=2e-4)


def test_tables_have_a_column_for_every_number(
    make_run: Callable[..., Path], tmp_path: Path
) -> None:
    folder = make_run()
    assert run_export(ExportOptions(folder, csv=True, out=tmp_path)) == 0
    with (tmp_path / "sender.agreement.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) > 100
    assert {"utc_ns", "stamp_ns", "iou", "mapped_box.0", "mapped_box.3"} <= rows[0].keys()


def test_nothing_asked_for_is_refused(make_run: Callable[..., Path]) -> None:
    with pytest.raises(PartError, match="nothing is asked for"):
        run_export(ExportOptions(make_run()))


@pytest.fixture
def scp(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two other computers, each a folder, an scp that copies from them, and an empty folder to be
    in.
    """
    computers, laptop, programs = (tmp_path / name for name in ("computers", "laptop", "programs"))
    for folder in (computers, laptop, programs):
        folder.mkdir()
    program = programs / "scp"
    program.write_text(
        '#!/bin/sh\n'
        'for last; do from=$source; source=$last; done\n'
        'host=${from%%:*}; host=${host#*@}; path=${from#*:}\n'
        f'[ -d {computers}/"$host" ] || {{ echo "ssh: Could not resolve hostname $host" >&2; exit 255; }}\n'
        f'exec cp -r {computers}/"$host"/"$path" "$last"\n'
    )  # fmt: skip
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{programs}:{os.environ['PATH']}")
    monkeypatch.chdir(laptop)
    return computers


def test_logs_of_two_companions_are_fetched_and_merged_by_one_command(
    scp: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    both = scp / "both"
    both.mkdir()
    write_logs(both)
    for host, name in (("d1", "sender"), ("d2", "receiver")):
        (scp / host / "runs" / "7").mkdir(parents=True)
        (both / f"{name}.mcap").rename(scp / host / "runs" / "7" / f"{name}.mcap")
    named = (Path("d1:runs/7"), Path("path@d2:runs/7"))
    assert run_merge(MergeOptions(named, out=Path("flight.mcap"))) == 0
    said = capsys.readouterr().out
    assert "fetching d1:runs/7" in said
    assert "known within" in said
    assert Path("flight.mcap").stat().st_size > 0
    assert {each.name for each in Path().iterdir()} == {"d1-7", "d2-7", "flight.mcap"}
    with pytest.raises(PartError, match="d1-7 is there already") as caught:
        run_merge(MergeOptions(named))
    assert "name d1-7 instead" in caught.value.remedy


def test_a_computer_that_is_not_there_is_said_in_its_words(scp: Path) -> None:
    with pytest.raises(
        PartError, match=r"d3:runs/7 was not fetched: ssh: Could not resolve hostname d3"
    ) as caught:
        run_merge(MergeOptions((Path("d3:runs/7"),)))
    assert "scp -r d3:runs/7 d3-7" in caught.value.remedy
    with pytest.raises(PartError, match="is a log on another computer"):
        run_merge(MergeOptions((Path("d1:runs/7/sender.mcap"),)))
    assert not list(Path().iterdir())


@pytest.mark.parametrize("options", [{"csv": True}, {"tum": True}])
def test_logs_with_nothing_in_them_are_no_export_that_went_well(
    tmp_path: Path, options: dict[str, Any]
) -> None:
    for name in ("sender", "receiver"):
        (tmp_path / f"{name}.mcap").write_bytes(b"\x89MCAP0\r\n")
    with pytest.raises(PartError, match="hold nothing to be written") as caught:
        run_export(ExportOptions(tmp_path, **options))
    assert caught.value.remedy
    assert not (tmp_path / "export").exists()


def test_the_target_is_a_trajectory_in_the_markers_frame(run_folder: Path, tmp_path: Path) -> None:
    folder = tmp_path / "filmed"  # as of films: no world, no run.json
    folder.mkdir()
    shutil.copy(run_folder / "sender.mcap", folder)
    assert run_export(ExportOptions(folder, tum=True, out=tmp_path / "out")) == 0
    rows = np.loadtxt(tmp_path / "out" / "target.tum")
    logged = [
        r.record["point_v_m"]
        for r in read_log(folder / "sender.mcap")
        if r.topic == "/target" and r.record["point_v_m"]
    ]
    assert rows[:, 1:4] == pytest.approx(np.array(logged), abs=1e-8)
    assert (rows[:, 7] == 1.0).all()
