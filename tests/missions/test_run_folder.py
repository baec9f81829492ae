"""No command deletes or writes over what it did not make."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from drivers.interfaces import PartError
from missions.relay.command import RELAY
from missions.report.records import FACTS, RUN
from missions.run_folder import RunKind, claim_result, claimed, unless_refused

RELAY_RUN = RunKind(RELAY, ("summary.json", "relay.png"), ("world", "D1", "D2"))
OURS = ("sender.mcap", "sender.2.mcap", "receiver.guard.mcap", "world.stderr.txt", "sender.state.json", "run.png")
USERS = ("notes.mcap", "letter.stderr.txt", "save.state.json", "sender.mcap.bak", "mysender.mcap", "rig.toml")


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
def test_what_has_the_name_of_a_runs_file_and_no_run_beside_it_is_not_touched(tmp_path: Path, name: str) -> None:
    before = fill(tmp_path, name, "notes.mcap")
    with pytest.raises(PartError, match=name) as refused:
        claim(tmp_path, RUN)
    assert "--out" in refused.value.remedy
    assert kept(tmp_path, before)
    assert sorted(before) == sorted(file.name for file in tmp_path.iterdir())


@pytest.mark.parametrize("content", ["", "[]", "{}", "null", '{"scripts": {"test": "x"}}', "\x00\x01"])
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
    with pytest.raises(PartError), unless_refused(tmp_path / "a" / "b") as folder, claimed(folder, RUN):
        assert (folder / FACTS).exists()
        raise PartError("no")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_was_there_stays_after_a_refusal(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    with pytest.raises(PartError), unless_refused(tmp_path / "mine") as folder, claimed(folder, RUN):
        raise PartError("no")
    assert [file.name for file in tmp_path.iterdir()] == ["mine"]
    assert list((tmp_path / "mine").iterdir()) == []


def test_what_a_refused_run_has_written_stays(tmp_path: Path) -> None:
    with pytest.raises(PartError), unless_refused(tmp_path / "a") as folder:
        (folder / "sender.mcap").write_text("records")
        raise PartError("no")
    assert (tmp_path / "a" / "sender.mcap").exists()
