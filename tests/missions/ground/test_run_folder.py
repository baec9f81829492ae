"""No command deletes or writes over what it did not make."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from drivers.interfaces import PartError
from missions.field import detect
from missions.field.calibrate import board, camera, mount
from missions.fly.guard.measure import measure
from missions.fly.handoff import command as handoff
from missions.ground.options.calibrate import (
    CalibrateBoardOptions,
    CalibrateCameraOptions,
    CalibrateMountOptions,
)
from missions.ground.options.field import DetectOptions, GuardOptions
from missions.ground.options.flights import HandoffOptions
from missions.ground.options.proofs import (
    CampaignOptions,
    ConformanceOptions,
    TrialOptions,
    VerifyOptions,
)
from missions.ground.run_folder import (
    RunKind,
    claim_folder,
    claim_result,
    claimed,
    discard,
    unless_refused,
)
from missions.look.report.records import FACTS, RUN
from missions.proofs.campaign import run as campaign
from missions.proofs.conformance import run as conformance
from missions.proofs.verify import run as verify
from missions.trials import run as trial_run

RELAY_RUN = RunKind("relay.json", ("summary.json", "relay.png"), ("world", "D1", "D2"))
OURS = (
    "sender.mcap",
    "sender.2.mcap",
    "receiver.guard.mcap",
    "world.stderr.txt",
    "sender.state.json",
    "run.png",
)
USERS = (
    "notes.mcap",
    "letter.stderr.txt",
    "save.state.json",
    "sender.mcap.bak",
    "mysender.mcap",
    "rig.toml",
)


def fill(folder: Path, *names: str) -> dict[str, bytes]:
    for name in names:
        (folder / name).write_text(f"contents of {name}")
    return {name: (folder / name).read_bytes() for name in names}


def claim(folder: Path, kind: RunKind) -> None:
    with claimed(folder, kind):
        pass


def kept(folder: Path, before: dict[str, bytes]) -> bool:
    return all((folder / name).read_bytes() == content for name, content in before.items())


def test_an_earlier_run_makes_way_and_what_is_the_users_stays(tmp_path: Path) -> None:
    claim(tmp_path, RUN)
    fill(tmp_path, *OURS)
    before = fill(tmp_path, *USERS)
    claim(tmp_path, RUN)
    assert kept(tmp_path, before)
    assert not any((tmp_path / name).exists() for name in OURS)


@pytest.mark.parametrize("name", [*OURS, "summary.json"])
def test_what_has_the_name_of_a_runs_file_and_no_run_beside_it_is_not_touched(
    tmp_path: Path, name: str
) -> None:
    before = fill(tmp_path, name, "notes.mcap")
    with pytest.raises(PartError, match=name) as refused:
        claim(tmp_path, RUN)
    assert "--out" in refused.value.remedy
    assert kept(tmp_path, before)
    assert sorted(before) == sorted(file.name for file in tmp_path.iterdir())


@pytest.mark.parametrize(
    "content", ["", "[]", "{}", "null", '{"scripts": {"test": "x"}}', "\x00\x01"]
)
def test_a_run_json_of_something_else_is_no_marker(tmp_path: Path, content: str) -> None:
    (tmp_path / FACTS).write_text(content)
    before = fill(tmp_path, "sender.mcap")
    with pytest.raises(PartError, match="nothing is written over"):
        claim(tmp_path, RUN)
    assert (tmp_path / FACTS).read_text() == content
    assert kept(tmp_path, before)


def test_a_run_that_was_cut_off_makes_way_too(tmp_path: Path) -> None:
    claim(tmp_path, RUN)
    fill(tmp_path, "sender.mcap")
    claim(tmp_path, RUN)
    assert [file.name for file in tmp_path.iterdir()] == [FACTS]
    assert json.loads((tmp_path / FACTS).read_bytes()) == {"outcome": "unfinished"}


def test_a_relay_knows_its_own_drones_files(tmp_path: Path) -> None:
    claim(tmp_path, RELAY_RUN)
    fill(tmp_path, "D1.mcap", "D2.guard.stderr.txt", "D1.state.json")
    before = fill(tmp_path, "D3.mcap", "sender.mcap", *USERS)
    claim(tmp_path, RELAY_RUN)
    assert kept(tmp_path, before)
    assert not (tmp_path / "D1.mcap").exists()


def test_a_folder_of_a_handoff_is_not_a_relays(tmp_path: Path) -> None:
    claim(tmp_path, RUN)
    before = fill(tmp_path, "world.mcap")
    with pytest.raises(PartError, match=r"no relay\.json of an earlier run"):
        claim(tmp_path, RELAY_RUN)
    assert kept(tmp_path, before)


def test_a_result_is_written_over_only_when_it_is_an_earlier_one(tmp_path: Path) -> None:
    claim_result(tmp_path / "summary.json", '"failed_seeds"')
    before = fill(tmp_path, "summary.json")
    with pytest.raises(PartError, match=r"summary\.json is there, and is no earlier result"):
        claim_result(tmp_path / "summary.json", '"failed_seeds"')
    assert kept(tmp_path, before)
    (tmp_path / "summary.json").write_text('{"runs": 2, "failed_seeds": {}}')
    claim_result(tmp_path / "summary.json", '"failed_seeds"')


def test_a_run_that_is_refused_leaves_nothing(tmp_path: Path) -> None:
    with (
        pytest.raises(PartError),
        unless_refused(tmp_path / "a" / "b") as folder,
        claimed(folder, RUN),
    ):
        assert (folder / FACTS).exists()
        raise PartError("no")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_was_there_stays_after_a_refusal(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    with (
        pytest.raises(PartError),
        unless_refused(tmp_path / "mine") as folder,
        claimed(folder, RUN),
    ):
        raise PartError("no")
    assert [file.name for file in tmp_path.iterdir()] == ["mine"]
    assert list((tmp_path / "mine").iterdir()) == []


def test_what_a_refused_run_has_written_stays(tmp_path: Path) -> None:
    with pytest.raises(PartError), unless_refused(tmp_path / "a") as folder:
        (folder / "sender.mcap").write_text("records")
        raise PartError("no")
    assert (tmp_path / "a" / "sender.mcap").exists()


def test_a_folder_of_many_results_is_taken_when_it_is_empty_or_an_earlier_one(
    tmp_path: Path,
) -> None:
    claim_folder(tmp_path, "summary.json", '"findings"')
    before = fill(tmp_path, "errors.png")
    with pytest.raises(PartError, match=r"holds errors\.png, and is no earlier result"):
        claim_folder(tmp_path, "summary.json", '"findings"')
    assert kept(tmp_path, before)
    (tmp_path / "summary.json").write_text('{"findings": []}')
    claim_folder(tmp_path, "summary.json", '"findings"')


def test_of_a_run_that_is_thrown_away_what_is_not_its_own_stays(tmp_path: Path) -> None:
    own, mine = tmp_path / "own", tmp_path / "mine"
    for folder in (own, mine):
        folder.mkdir()
        fill(folder, "sender.mcap", "run.json", "world.mcap")
    before = fill(mine, "notes.txt", "lens.png")
    for folder in (own, mine):
        discard(folder, RUN)
    assert not own.exists()
    assert kept(mine, before)
    assert sorted(file.name for file in mine.iterdir()) == ["lens.png", "notes.txt"]


def user_file(file: Path) -> bytes:
    content = b"somebody's own work\n"
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(content)
    return content


COMMANDS: dict[str, tuple[str, Callable[[Path], object]]] = {
    "trial, its summary": ("summary.json", lambda out: trial_run.run(TrialOptions("static", out=out, jobs=1))),
    "trial, a picture": ("errors.png", lambda out: trial_run.run(TrialOptions("static", out=out, jobs=1))),
    "all trials, a trial's folder": (
        "static/errors.png", lambda out: trial_run.run(TrialOptions("all", out=out, jobs=1, quick=True))
    ),
    "guard --measure, its summary": (
        "summary.json", lambda out: measure(GuardOptions(rig="sim", out=out, measure=True))
    ),
    "guard --measure, a rig": ("rig.toml", lambda out: measure(GuardOptions(rig="sitl", out=out, measure=True))),
    "conformance, a vehicle": (
        "embedded.json", lambda out: conformance.run(ConformanceOptions(out=out, fly=False))
    ),
    "conformance, the page": (
        "page.md", lambda out: conformance.run(ConformanceOptions(out=out / "new", fly=False, page=out / "page.md"))
    ),
    "verify": ("summary.json", lambda out: verify.run(VerifyOptions(out=out, quick=True))),
    "detect, a picture": (
        "000000.jpg", lambda out: detect.run(DetectOptions(frames=pictures(out.parent / "frames"), out=out))
    ),
    "calibrate board": (
        "a.png", lambda out: board.draw_print(CalibrateBoardOptions(out=out / "a.png"), io.StringIO())
    ),
    "calibrate camera": (
        "a.toml", lambda out: camera.calibrate_camera(camera_options(out / "a.toml"), io.StringIO())
    ),
    "calibrate camera, its picture": (
        "a.png", lambda out: camera.calibrate_camera(camera_options(out / "a.toml"), io.StringIO())
    ),
    "calibrate mount": (
        "m.toml", lambda out: mount.calibrate_mount(CalibrateMountOptions(rig="sim", out=out / "m.toml"), io.StringIO())
    ),
    "handoff --junit": (
        "j.xml", lambda out: handoff.run(HandoffOptions(rig="sim", seeds=2, out=out / "new", junit=out / "j.xml"))
    ),
    "campaign --junit": (
        "j.xml", lambda out: campaign.run(CampaignOptions(runs=1, out=out / "new", junit=out / "j.xml"))
    ),
}  # fmt: skip


def pictures(folder: Path) -> Path:
    folder.mkdir()
    assert cv2.imwrite(str(folder / "a.png"), np.zeros((48, 64, 3), np.uint8))
    return folder


def camera_options(out: Path) -> CalibrateCameraOptions:
    return CalibrateCameraOptions(out=out, images=pictures(out.parent.parent / "frames"))


@pytest.mark.parametrize("name", COMMANDS)
def test_no_command_writes_over_what_it_did_not_make(name: str, tmp_path: Path) -> None:
    file, command = COMMANDS[name]
    folder = tmp_path / "mine"
    content = user_file(folder / file)
    with pytest.raises(PartError) as refused:
        command(folder)
    assert refused.value.remedy and str(folder) in str(refused.value)
    assert (folder / file).read_bytes() == content
    assert [path for path in sorted(folder.rglob("*")) if path.is_file()] == [folder / file]
