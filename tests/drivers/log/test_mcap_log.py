"""The log: what is written comes back, whatever happened to the process or the disk."""

from __future__ import annotations

import math
import os
import threading
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.log.loose_file import LooseFile
from drivers.log.mcap_log import (
    VIRTUAL_EPOCH_NS,
    LogRecord,
    McapLog,
    decode_image,
    new_part,
    parts,
    read_log,
)
from tests.written_logs import until_written


class Colour(Enum):
    RED = "red"


@dataclass(frozen=True)
class Point:
    x: float
    y: float


def written(path: Path, count: int) -> list[LogRecord]:
    with McapLog(path, utc_minus_stamp_ns=VIRTUAL_EPOCH_NS) as log:
        for k in range(count):
            log.write("/odd" if k % 2 else "/even", 1_000 * k, {"k": k})
        assert log.failed is None
    return list(read_log(path))


def test_records_come_back_in_order(tmp_path: Path) -> None:
    records = written(tmp_path / "deep" / "a.mcap", 5)
    assert records[1] == LogRecord("/odd", 1_000, {"k": 1})
    assert [r.record["k"] for r in records] == [0, 1, 2, 3, 4]


def test_values_of_all_kinds_are_encoded(tmp_path: Path) -> None:
    record = {
        "array": np.array([1.0, math.nan]),
        "scalar": np.float32(0.5),
        "count": np.int64(3),
        "infinite": math.inf,
        "tuple": (1, 2),
        "enum": Colour.RED,
        "point": Point(1.0, -math.inf),
        "nested": {"none": None},
    }
    with McapLog(tmp_path / "a.mcap") as log:
        log.write("/t", 1, record)
        assert log.failed is None
    (only,) = read_log(tmp_path / "a.mcap")
    assert only.record == {
        "array": [1.0, None],
        "scalar": 0.5,
        "count": 3,
        "infinite": None,
        "tuple": [1, 2],
        "enum": "red",
        "point": {"x": 1.0, "y": None},
        "nested": {"none": None},
    }


def test_a_log_is_readable_while_it_is_written_and_however_it_is_cut(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with McapLog(path) as log:
        for k in range(20):
            log.write("/state", k, {"k": k, "text": "x" * 50})
        until_written(log)
        open_bytes = path.read_bytes()
        assert len(list(read_log(path))) == 20  # as after a kill -9
    counts: list[int] = []
    for length in range(8, len(open_bytes), 7):
        (tmp_path / "cut.mcap").write_bytes(open_bytes[:length])
        records = list(read_log(tmp_path / "cut.mcap"))
        assert [r.record["k"] for r in records] == list(range(len(records)))
        counts.append(len(records))
    assert counts == sorted(counts)
    assert counts[-1] >= 19


def test_the_same_records_give_the_same_bytes(tmp_path: Path) -> None:
    written(tmp_path / "a.mcap", 50)
    written(tmp_path / "b.mcap", 50)
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


def test_images_are_foxglove_jpegs(tmp_path: Path) -> None:
    image = np.zeros((48, 64, 3), np.uint8)
    image[:, 32:] = (0, 128, 255)
    with McapLog(tmp_path / "a.mcap", "D1") as log:
        log.image("/image", 2_000_000_003, image)
    (only,) = read_log(tmp_path / "a.mcap")
    assert only.stamp_ns == 2_000_000_003
    assert (only.record["frame_id"], only.record["format"]) == ("D1/camera", "jpeg")
    assert np.abs(decode_image(only.record).astype(int) - image).mean() < 2.0


@pytest.mark.parametrize("bits", [np.uint16, np.float32, np.float64])
def test_an_image_of_more_than_8_bits_is_refused_by_name_and_none_of_it_is_cut_off(
    tmp_path: Path, bits: type
) -> None:
    image: Any = np.full((48, 64, 3), 300, bits)
    with McapLog(tmp_path / "a.mcap", "D1") as log:
        log.image("/depth", 1, image)
    assert log.failed == "/depth: the image could not be encoded as JPEG, of 8 bits"
    assert list(read_log(tmp_path / "a.mcap")) == []


@pytest.mark.parametrize("closed", [False, True])
def test_a_log_with_a_bit_turned_over_is_read_up_to_there_or_refused(
    tmp_path: Path, closed: bool
) -> None:
    """Whatever a disk did to it, nothing but ValueError is raised."""
    log, copy = McapLog(tmp_path / "a.mcap", "D1"), tmp_path / "damaged.mcap"
    for k in range(12):
        log.write("/odd" if k % 2 else "/even", k, {"k": k})
    if closed:
        log.close()
    else:
        until_written(log)
    whole = (tmp_path / "a.mcap").read_bytes()
    log.close()
    for place in range(0, len(whole), 41):
        copy.write_bytes(
            whole[:place] + bytes([whole[place] ^ 1 << place % 8]) + whole[place + 1 :]
        )
        with suppress(ValueError):
            assert len(list(read_log(copy))) <= 12


def test_a_full_disk_is_remembered_and_stops_nothing() -> None:
    with McapLog(Path("/dev/full")) as log:
        for k in range(3):
            log.write("/state", k, {})
            log.image("/image", k, np.zeros((4, 4, 3), np.uint8))
    assert log.failed is not None
    assert "No space left" in log.failed


def test_a_disk_that_fails_at_the_last_record_is_known_before_the_flights_end_is_told() -> None:
    log = McapLog(Path("/dev/full"))
    log.write("/outcome", 1, {"outcome": "committed"})
    told = log.settled()
    assert told is not None and "No space left" in told


def standing_disk(folder: Path) -> tuple[Path, int]:
    """A file that takes 64 kB and then stands still, until it is read from."""
    path = folder / "a.mcap"
    os.mkfifo(path)
    return path, os.open(path, os.O_RDONLY | os.O_NONBLOCK)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs a pipe in the file system")
def test_a_disk_that_stands_still_holds_up_no_flight_and_all_is_written_once_it_goes_on(
    tmp_path: Path,
) -> None:
    path, reader = standing_disk(tmp_path)
    with McapLog(path) as log:
        for k in range(400):
            log.write("/some", k, {"k": k, "text": "x" * 1000})
        assert log.failed is None
        os.set_blocking(reader, True)
        with os.fdopen(reader, "rb") as disk:
            drained = threading.Thread(
                target=lambda: (tmp_path / "copy.mcap").write_bytes(disk.read())
            )
            drained.start()
            log.close()
            drained.join(60.0)
    records = read_log(tmp_path / "copy.mcap")
    assert [record.record["k"] for record in records] == list(range(400))


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs a pipe in the file system")
def test_records_that_found_no_room_while_a_disk_stood_still_are_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(LooseFile.__init__, "__defaults__", (200_000,))
    path, reader = standing_disk(tmp_path)
    log = McapLog(path)
    for k in range(400):
        log.write(f"/topic{k % 7}", k, {"text": "x" * 1000})
    told = log.failed
    os.close(reader)
    log.close()
    assert told is not None and "the disk stood still" in told


def test_an_unwritable_folder_is_remembered(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    log = McapLog(tmp_path / "file" / "a.mcap")
    log.write("/state", 0, {})
    log.close()
    assert log.failed is not None


def test_one_bad_record_does_not_cost_the_others(tmp_path: Path) -> None:
    with McapLog(tmp_path / "a.mcap") as log:
        log.write("/state", 0, {"bad": object()})
        log.write("/state", -1, {})
        log.write("/state", 1, {})
        assert log.failed is not None
        assert "cannot log a object" in log.failed
    assert [r.stamp_ns for r in read_log(tmp_path / "a.mcap")] == [1]


def test_what_is_no_log_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"something else")
    with pytest.raises(ValueError, match="not an MCAP file"):
        list(read_log(tmp_path / "a.mcap"))


def test_no_program_writes_over_the_log_of_an_earlier_one(tmp_path: Path) -> None:
    for k in range(11):
        with McapLog(new_part(tmp_path / "run", "sender")) as log:
            log.write("/state", k, {"k": k})
    (tmp_path / "run" / "sender.old.mcap").touch()
    (tmp_path / "run" / "receiver.mcap").touch()
    files = parts(tmp_path / "run", "sender")
    assert [file.name for file in files[:2]] == ["sender.mcap", "sender.2.mcap"]
    assert [record.stamp_ns for file in files for record in read_log(file)] == list(range(11))


def test_a_program_killed_before_it_wrote_anything_leaves_a_log_of_nothing(tmp_path: Path) -> None:
    assert list(read_log(new_part(tmp_path, "sender"))) == []


def test_where_nothing_can_be_written_the_log_says_so(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    log = McapLog(new_part(tmp_path / "file", "sender"))
    assert log.failed is not None
