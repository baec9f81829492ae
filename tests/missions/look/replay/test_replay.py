"""Decisions come out of the log again, record for record; other settings decide as if they had been
flown with.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from drivers.interfaces import PartError
from drivers.log.mcap_log import LogRecord, read_log, virtual_log
from missions.fly.handoff.flight import fly_once
from missions.ground import rig_library
from missions.ground.options.runs import ReplayOptions
from missions.look.replay import command
from missions.look.replay.command import EXIT_DIFFERENT, change_of, replay_changed, run
from missions.look.replay.perceive import PerceptionChange, perceiver_of
from missions.look.replay.redecide import Complete, DecisionPair, redecide
from missions.look.report.records import PAGE, REPLAY, drone_logs
from tests.flown import flown_once
from tests.missions.look.replay.filmed import make_films

RECORDED = "sim-rendered, every frame recorded"
RECORDS = (
    ("[mission]\n", '[mission]\nrecord = "all"\n'),
    ("hold_frames = 350\nhold_s = 7.0\n", 'gate = "count"\nhold_frames = 75\nhold_s = 2.5\n'),
    ("rate_hz = 50.0\n", "rate_hz = 15.0\n"),
)
CHANGED = PerceptionChange(settings={"min_saturation": 1.0})  # with which nothing is seen
SETTINGS = (
    "method.tau_min=0.3",
    "method.tau_max=0.55",
    "method.hold_s=5.0",
    "method.hold_frames=240",
)


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    made: dict[tuple[str, ...], Path] = {}

    def fly(rig: str, seed: int, *faults: str) -> Path:
        if rig == "sim":
            return flown_once(tmp_path_factory, seed, *faults)
        key = (rig, str(seed), *faults)
        if key not in made:
            made[key] = tmp_path_factory.mktemp("run")
            name = str(recorded_rig(made[key])) if rig == RECORDED else rig
            fly_once(rig_library.load(name), seed, faults, made[key], lambda _: None)
        return made[key]

    return fly


def recorded_rig(folder: Path) -> Path:
    """sim-rendered with every frame recorded, slower and shorter."""
    text = rig_library.whole("sim-rendered")
    for old, new in RECORDS:
        assert old in text
        text = text.replace(old, new)
    (folder / "recorded.toml").write_text(text, "utf-8")
    return folder / "recorded.toml"


def decided(records: list[LogRecord]) -> list[DecisionPair]:
    return [each for each in redecide(records) if isinstance(each, DecisionPair)]


@pytest.mark.parametrize(
    ("rig", "seed", "faults"),
    [
        ("sim", 2, ()),
        ("sim", 8, ("link_loss=0.3",)),
        ("sim", 1, ("kill_sender=1@verify+1",)),
        ("sim", 3, ("step_north_sender=-0.7@verify+1", "step_yaw_sender=-30@verify+1")),
        (RECORDED, 2, ("kill_receiver@verify+3",)),
    ],
)
def test_every_decision_comes_out_again(
    flown: Callable[..., Path], rig: str, seed: int, faults: tuple[str, ...]
) -> None:
    logs = drone_logs(flown(rig, seed, *faults))
    assert set(logs) == {"sender", "receiver"}
    for records in logs.values():
        again = decided(records)
        logged = [r for r in records if r.topic in ("/candidate", "/agreement")]
        assert len(again) >= len(logged) > 30
        assert [each for each in again if not each.same or each.unsaid] == []


def test_what_an_earlier_version_did_not_log_is_no_difference_and_is_named(
    flown: Callable[..., Path], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def earlier(folder: Path) -> dict[str, list[LogRecord]]:
        return {
            name: [without(each) for each in records]
            for name, records in drone_logs(folder).items()
        }

    def without(each: LogRecord) -> LogRecord:
        # as it is read from its log
        kept = each.record | ({"oversize": None} if each.topic == "/agreement" else {})
        return LogRecord(each.topic, each.stamp_ns, kept)

    monkeypatch.setattr(command, "drone_logs", earlier)
    assert run(ReplayOptions((flown("sim", 2),), picture=False)) == 0
    assert "earlier version of PATH wrote this log: oversize" in " ".join(
        capsys.readouterr().out.split()
    )


def test_a_decision_that_was_another_one_is_found(flown: Callable[..., Path]) -> None:
    folder = flown("sim", 2)
    records = list(read_log(folder / "sender.mcap"))
    k = next(k for k, r in enumerate(records) if r.topic == "/agreement" and r.record["agreed"])
    records[k] = LogRecord(
        "/agreement", records[k].stamp_ns, {**records[k].record, "agreed": False}
    )
    (different,) = [each for each in decided(records) if not each.same]
    assert different.again is not None
    assert different.again["agreed"] is True


def test_other_settings_decide_as_if_they_had_been_flown_with(
    flown: Callable[..., Path], tmp_path: Path
) -> None:
    text = rig_library.whole("sim")
    papers = 'gate = "count"\nhold_frames = 350\nhold_s = 7.0\n'
    lines = 'gate = "count"\n' + "".join(
        f"{s.removeprefix('method.').replace('=', ' = ')}\n" for s in SETTINGS
    )
    assert text.count("hold_frames = 350\nhold_s = 7.0\n") == 1
    for name, instead in (("papers", papers), ("other", lines)):
        changed = text.replace("hold_frames = 350\nhold_s = 7.0\n", instead)
        (tmp_path / f"{name}.toml").write_text(changed, "utf-8")
    change = change_of(SETTINGS, None)
    assert change is not None
    replayed = {
        each.drone: each
        for each in replay_changed(drone_logs(flown(str(tmp_path / "papers.toml"), 3)), change)
    }
    with_them = list(
        redecide(list(read_log(flown(str(tmp_path / "other.toml"), 3) / "sender.mcap")))
    )
    (complete,) = replayed["sender"].complete
    assert complete in [each for each in with_them if isinstance(each, Complete)]
    mine = verdicts(replayed["sender"].decided, complete.stamp_ns)
    theirs = verdicts(
        [each for each in with_them if isinstance(each, DecisionPair)], complete.stamp_ns
    )
    assert len(mine) >= 240
    assert mine == theirs


def verdicts(decided: Any, until_ns: int) -> list[Mapping[str, Any]]:
    return [d.again for d in decided if d.topic == "/agreement" and d.stamp_ns <= until_ns]


def test_the_command_says_what_would_have_been(
    flown: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = shutil.copytree(flown("sim", 2), tmp_path / "run")
    assert run(ReplayOptions((folder,))) == 0
    assert not (folder / REPLAY).exists()
    assert run(ReplayOptions((folder,), gate="count")) == 0
    assert (folder / REPLAY).stat().st_size > 10_000
    assert "gate complete, after the first answer" in capsys.readouterr().out


def test_perception_runs_again_on_the_recorded_frames(
    flown: Callable[..., Path], capsys: pytest.CaptureFixture[str]
) -> None:
    """H.264 loses a little, depth nothing: the boxes are the same ones, about a pixel off."""
    folder = flown(RECORDED, 2, "kill_receiver@verify+3")
    logs = drone_logs(folder)
    perceivers = {name: perceiver_of(folder, name, PerceptionChange()) for name in logs}
    again = {each.drone: each for each in replay_changed(logs, lambda method: method, perceivers)}
    for drone, topic, enough in (("sender", "/target", 100), ("receiver", "/candidate", 15)):
        pairs = [each for each in again[drone].decided if each.topic == topic]
        assert len(pairs) > enough
        both = [
            (each.logged["box"], each.again["box"]) for each in pairs if each.logged and each.again
        ]
        seen = [(was, now) for was, now in both if was is not None and now is not None]
        assert len(seen) >= 0.9 * sum(was is not None for was, _ in both) > 0.5 * enough
        off_px = sorted(max(abs(a - b) for a, b in zip(was, now, strict=True)) for was, now in seen)
        assert 0.0 < off_px[len(off_px) // 2] < 2.0
    capsys.readouterr()
    assert run(ReplayOptions((folder,), frames=True)) == 0
    assert "frames with a candidate" in capsys.readouterr().out
    blind = {"sender": perceiver_of(folder, "sender", CHANGED)}
    last = [k for k, each in enumerate(logs["sender"]) if each.topic == "/target"][100]
    first_hundred = {"sender": logs["sender"][:last]}
    (sender,) = replay_changed(first_hundred, lambda method: method, blind)
    targets = [each.again for each in sender.decided if each.topic == "/target" and each.again]
    assert len(targets) == 100 and not any(each["box"] for each in targets)


def test_a_run_without_frames_says_how_to_record_them(flown: Callable[..., Path]) -> None:
    with pytest.raises(PartError, match="recorded no frames") as caught:
        run(ReplayOptions((flown("sim", 2),), frames=True))
    assert 'record = "all"' in caught.value.remedy


@pytest.mark.parametrize(
    "setting", ["method.tau=1", "world.tau_min=0.3", "method.tau_min", "method.tau_min=0.9"]
)
def test_a_setting_that_cannot_be_is_refused(flown: Callable[..., Path], setting: str) -> None:
    with pytest.raises(PartError, match="--set"):
        run(ReplayOptions((flown("sim", 2),), set=(setting,)))


def test_many_runs_are_counted(
    flown: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good = flown("sim", 2)
    assert run(ReplayOptions((good, tmp_path))) == 0
    assert "1 runs," in capsys.readouterr().out
    records = list(read_log(good / "sender.mcap"))
    with virtual_log(tmp_path / "sender.mcap", "sender") as log:
        for each in records:
            wrong = {"agreed": False} if each.topic == "/agreement" else {}
            log.write(each.topic, each.stamp_ns, {**each.record, **wrong})
    assert run(ReplayOptions((good, tmp_path))) == EXIT_DIFFERENT
    with pytest.raises(PartError, match="one run"):
        run(ReplayOptions((good, tmp_path), gate="evidence"))


def test_a_folder_without_logs_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PartError, match="no drone's log"):
        run(ReplayOptions((tmp_path,)))


# --- films that were made without PATH


@pytest.fixture(scope="module")
def films(flown: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What two cameras filmed of that run, for a second and a half while both looked at the
    target.
    """
    return make_films(
        flown(RECORDED, 2, "kill_receiver@verify+3"), tmp_path_factory.mktemp("films"), (0.5, 2.5)
    )


def test_films_decide_as_the_flight_that_they_were_made_of(
    flown: Callable[..., Path], films: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """From pixels, stamps and trajectories alone: the same verdicts, boxes as far off as the coding
    puts them.
    """
    out = tmp_path / "out"
    assert run(ReplayOptions((films,), gate="evidence", out=out)) == 0
    assert "evidence" in capsys.readouterr().out or (out / REPLAY).stat().st_size > 10_000
    page = (out / PAGE).read_text("utf-8")
    assert "no_agreement</span>" in page and "sender: answers that agree" in page
    assert page.count("<svg class='seen'") >= 2 and ">marker</text>" in page
    as_flown, as_filmed = drone_logs(flown(RECORDED, 2, "kill_receiver@verify+3")), drone_logs(out)
    for drone, topic in (("sender", "/target"), ("receiver", "/candidate")):
        was = {
            each.record["capture_ns"]: each.record
            for each in as_flown[drone]
            if each.topic == topic
        }
        now = [
            each.record
            for each in as_filmed[drone]
            if each.topic == topic and each.record["reason"] != "link_silent"
        ]
        ahead_ns = 0 if drone == "sender" else clock_ahead_ns(as_flown["receiver"])
        pairs = [(was[nearest(was, each["capture_ns"] + ahead_ns)], each) for each in now]
        assert len(pairs) >= 20
        both = [
            (a["box"], b["box"]) for a, b in pairs if a["box"] is not None and b["box"] is not None
        ]
        assert len(both) >= 0.9 * len(pairs)
        off_px = sorted(max(abs(x - y) for x, y in zip(a, b, strict=True)) for a, b in both)
        assert off_px[len(off_px) // 2] < 2.0
    judged = [
        each.record
        for each in as_filmed["sender"]
        if each.topic == "/agreement" and each.record["iou"] is not None
    ]
    assert sum(each["agreed"] for each in judged) >= 0.9 * len(judged) >= 15
    assert run(ReplayOptions((out,))) == 0


def clock_ahead_ns(records: list[LogRecord]) -> int:
    """D2's clock less D1's, as D2 has measured it."""
    heard = next(each.record for each in records if each.topic == "/heard_target")
    return heard["capture_ns"] - heard["peer_capture_ns"]


def nearest(stamps: Mapping[int, Any], stamp_ns: int) -> int:
    return min(stamps, key=lambda each: abs(each - stamp_ns))


def test_drones_without_a_trajectory_are_taken_to_hang_level(films: Path, tmp_path: Path) -> None:
    level = films.parent / "level.toml"
    lines = films.read_text("utf-8").splitlines()
    level.write_text(
        "\n".join(line for line in lines if not line.startswith("trajectory")), "utf-8"
    )
    assert run(ReplayOptions((level,), out=tmp_path / "out", picture=False)) == 0
    judged = [
        each.record for each in drone_logs(tmp_path / "out")["sender"] if each.topic == "/agreement"
    ]
    assert sum(each["agreed"] for each in judged) >= 0.8 * len(judged) >= 15


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ('film = "d1.mkv"', 'film = "gone.mkv"', r"gone\.mkv: there is no such file"),
        (
            'film = "d2"',
            'film = "films.toml"',
            r"films\.toml: a recording of kind '\.toml' is not known",
        ),
        ('calibration = "receiver.camera.toml"\n', "", "receiver: missing key 'calibration'"),
        (
            'calibration = "receiver.camera.toml"',
            'calibration = "gone.toml"',
            r"gone\.toml: No such file",
        ),
        (
            'calibration = "receiver.camera.toml"',
            'calibration = "small.toml"',
            "d2 by small.toml: .* 320x240 px",
        ),
        ('depth = "d1-depth"', 'depth = "d2"', "d2/0.png: expected 16-bit depth"),
        (
            'stamps = "d1.csv"',
            'stamps = "short.csv"',
            r"short\.csv: 3 stamps for .*d1\.mkv, which has [0-9]{2} frames",
        ),
        ('depth = "d1-depth"\n', "", "d1.mkv: there is no depth with it"),
        ('stamps = "d1.csv"', 'stamps = "receiver.tum"', r"receiver\.tum: line 2: .* has no stamp"),
        ("offset_s = -", "offset_s = 9", "the films do not overlap on one clock: d1.mkv from"),
        (
            'trajectory = "sender.tum"',
            'trajectory = "d1.csv"',
            r"d1\.csv: line 1: 'stamp_ns' is no pose",
        ),
        ("pixel = [", "pixels = [", "unknown key 'pixels'.*did you mean 'pixel'"),
        ("pixel = [", "pixel = [9", "the target is not there at"),
        ("[target]\n", "[target]\nat_s = 900.0\n", "target.at_s = 900 is after the end"),
        ("[target]\n", "begin_s = 900.0\n[target]\n", "nothing is left between begin_s and end_s"),
    ],
)
def test_films_that_cannot_be_are_refused_by_name(
    films: Path, tmp_path: Path, old: str, new: str, what: str
) -> None:
    text, bad = films.read_text("utf-8"), films.parent / "bad.toml"
    assert text.count(old) == 1
    bad.write_text(text.replace(old, new), "utf-8")
    with pytest.raises(PartError, match=what) as caught:
        run(ReplayOptions((bad,), out=tmp_path / "out"))
    assert caught.value.remedy
    assert not (tmp_path / "out").exists() or not any((tmp_path / "out").glob("films.json"))


@pytest.mark.parametrize("steps", [5.0, 10.0, 0.1], ids=["0.2 mm", "0.1 mm", "10 mm"])
def test_depth_in_another_unit_is_told_of_and_read_when_its_unit_is_said(
    films: Path, tmp_path: Path, steps: float, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = films.parent / f"depth-{steps:g}"
    folder.mkdir()
    for file in (films.parent / "d1-depth").glob("*.png"):
        depth_mm = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
        assert depth_mm is not None
        scaled = np.clip(np.round(depth_mm * steps), 0, 65535).astype(np.uint16)
        cv2.imwrite(str(folder / file.name), scaled)
    bad = films.parent / f"unit-{steps:g}.toml"
    text = films.read_text("utf-8").replace('depth = "d1-depth"', f'depth = "{folder.name}"')
    bad.write_text(text, "utf-8")
    try:
        run(ReplayOptions((bad,), out=tmp_path / "out"))
        said = capsys.readouterr().out
    except PartError as error:
        said = f"{error} {error.remedy}"
    assert "are these millimetres?" in said
    assert "depth_unit_mm" in said
    times = float(said.partition(" times as far")[0].rpartition(" ")[2])
    assert times == pytest.approx(steps, rel=0.6)
    unit = f'depth = "{folder.name}"\ndepth_unit_mm = {1.0 / steps!r}'
    bad.write_text(films.read_text("utf-8").replace('depth = "d1-depth"', unit), "utf-8")
    assert run(ReplayOptions((bad,), out=tmp_path / "right")) == 0
    assert "millimetres" not in capsys.readouterr().out


def test_settings_of_a_runs_replay_are_none_of_films(
    films: Path, flown: Callable[..., Path]
) -> None:
    with pytest.raises(PartError, match="names its films and its rig itself"):
        run(ReplayOptions((films,), rig="sim-rendered"))
    with pytest.raises(PartError, match="--out is for films"):
        run(ReplayOptions((flown("sim", 2),), out=films.parent / "out"))
