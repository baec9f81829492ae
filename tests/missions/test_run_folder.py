"""No command deletes or writes over what it did not make."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from drivers.interfaces import PartError
from missions.relay.command import RELAY
from missions.report.records import FACTS, RUN
from missions.run_folder import RunKind, claim_folder, claim_result

RELAY_RUN = RunKind(RELAY, ("summary.json", "relay.png"), ("world", "D1", "D2"))
OURS = ("sender.mcap", "sender.2.mcap", "receiver.guard.mcap", "world.stderr.txt", "sender.state.json", "run.png")
USERS = ("notes.mcap", "letter.stderr.txt", "save.state.json", "sender.mcap.bak", "mysender.mcap", "rig.toml")


def fill(folder: Path, *names: str) -> dict[str, bytes]:
    for name in names:
        (folder / name).write_text(f"contents of {name}")
    return {name: (folder / name).read_bytes() for name in names}


def kept(folder: Path, before: dict[str, bytes]) -> bool:
    return all((folder / name).read_bytes() == content for name, content in before.items())


def test_an_earlier_run_makes_way_and_what_is_the_users_stays(tmp_path: Path) -> None:
    claim_folder(tmp_path, RUN)
    fill(tmp_path, *OURS)
    before = fill(tmp_path, *USERS)
    claim_folder(tmp_path, RUN)
    assert kept(tmp_path, before)
    assert not any((tmp_path / name).exists() for name in OURS)


@pytest.mark.parametrize("name", [*OURS, "summary.json"])
def test_what_has_the_name_of_a_runs_file_and_no_run_beside_it_is_not_touched(tmp_path: Path, name: str) -> None:
    before = fill(tmp_path, name, "notes.mcap")
    with pytest.raises(PartError, match=name) as refused:
        claim_folder(tmp_path, RUN)
    assert "--out" in refused.value.remedy
    assert kept(tmp_path, before)
    assert sorted(before) == sorted(file.name for file in tmp_path.iterdir())


@pytest.mark.parametrize("content", ["", "[]", "{}", "null", '{"scripts": {"test": "x"}}', "\x00\x01"])
def test_a_run_json_of_something_else_is_no_marker(tmp_path: Path, content: str) -> None:
    (tmp_path / FACTS).write_text(content)
    before = fill(tmp_path, "sender.mcap")
    with pytest.raises(PartError, match="nothing is written over"):
        claim_folder(tmp_path, RUN)
    assert (tmp_path / FACTS).read_text() == content
    assert kept(tmp_path, before)


def test_a_run_that_was_cut_off_makes_way_too(tmp_path: Path) -> None:
    claim_folder(tmp_path, RUN)
    fill(tmp_path, "sender.mcap")
    claim_folder(tmp_path, RUN)
    assert [file.name for file in tmp_path.iterdir()] == [FACTS]
    assert json.loads((tmp_path / FACTS).read_bytes()) == {"outcome": "unfinished"}


def test_a_relay_knows_its_own_drones_files(tmp_path: Path) -> None:
    claim_folder(tmp_path, RELAY_RUN)
    fill(tmp_path, "D1.mcap", "D2.guard.stderr.txt", "D1.state.json")
    before = fill(tmp_path, "D3.mcap", "sender.mcap", *USERS)
    claim_folder(tmp_path, RELAY_RUN)
    assert kept(tmp_path, before)
    assert not (tmp_path / "D1.mcap").exists()


def test_a_folder_of_a_handoff_is_not_a_relays(tmp_path: Path) -> None:
    claim_folder(tmp_path, RUN)
    before = fill(tmp_path, "world.mcap")
    with pytest.raises(PartError, match=r"no relay\.json of an earlier run"):
        claim_folder(tmp_path, RELAY_RUN)
    assert kept(tmp_path, before)


def test_a_summary_is_written_over_only_beside_runs(tmp_path: Path) -> None:
    claim_result(tmp_path, "summary.json", f"seed-*/{FACTS}")
    before = fill(tmp_path, "summary.json")
    with pytest.raises(PartError, match=r"summary\.json of something else"):
        claim_result(tmp_path, "summary.json", f"seed-*/{FACTS}")
    assert kept(tmp_path, before)
    (tmp_path / "seed-0001").mkdir()
    claim_folder(tmp_path / "seed-0001", RUN)
    claim_result(tmp_path, "summary.json", f"seed-*/{FACTS}")
