"""Beats and answers over loopback."""

from __future__ import annotations

import asyncio
import math
import socket
import stat
import time
from functools import partialmethod
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.interfaces import PartError
from drivers.mavlink.guard.interfaces import Beat, GuardAnswer, Hand, Script
from drivers.mavlink.guard.line import (
    FOREIGN,
    UdpBeatLine,
    UdpGuardLine,
    decode_answer,
    decode_beat,
    encode_answer,
    encode_beat,
    is_taken,
)
from drivers.mavlink.guard.seal import KeyReader, Seals, key_path, make_key
from flight.guard.rules import GuardRules
from tests.doubles import WallClock
from tests.free_ports import free_port
from tests.guard_bench import until

WORDS = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=90)
FLOATS = st.floats(width=32, allow_nan=False)


@given(
    st.builds(
        Beat,
        st.sampled_from(Script),
        st.integers(0, 2**32 - 1),
        FLOATS,
        st.tuples(FLOATS, FLOATS, FLOATS),
    )
)
def test_a_beat_comes_back_as_it_was(beat: Beat) -> None:
    assert decode_beat(encode_beat(beat)) == beat


@given(st.builds(GuardAnswer, st.booleans(), st.sampled_from(Hand), WORDS, WORDS))
def test_an_answer_comes_back_as_it_was(answer: GuardAnswer) -> None:
    assert decode_answer(encode_answer(answer)) == answer


@given(st.binary(max_size=60))
def test_anything_else_is_neither(packet: bytes) -> None:
    assert decode_beat(packet) is None
    assert decode_answer(packet) is None


def test_what_is_nearly_a_beat_is_none() -> None:
    packet = encode_beat(Beat(Script.CONTROL, 7))
    assert decode_beat(packet[:-1]) is None
    assert decode_beat(packet[:4] + b"\x09" + packet[5:]) is None
    assert decode_answer(packet) is None
    answer = encode_answer(GuardAnswer(True, Hand.GUARD, "why"))
    assert decode_answer(answer[:5] + b"\x09" + answer[6:]) is None
    assert decode_beat(answer) is None


def test_words_are_cut_where_a_packet_would_be_too_long_and_stay_apart() -> None:
    came = decode_answer(encode_answer(GuardAnswer(True, Hand.GUARD, 500 * "r", 500 * "a")))
    assert came == GuardAnswer(True, Hand.GUARD, 400 * "r", 400 * "a")
    between = decode_answer(encode_answer(GuardAnswer(False, Hand.FREE, "one\0two", "why")))
    assert between == GuardAnswer(False, Hand.FREE, "one two", "why")


def test_the_newest_beat_counts_and_the_answer_finds_its_way() -> None:
    async def main() -> None:
        bind, clock = f"127.0.0.1:{free_port()}", WallClock()
        assert not is_taken(bind)
        async with UdpBeatLine(bind, clock) as guard, UdpGuardLine(bind, clock) as role:
            assert is_taken(bind)
            guard.answer(GuardAnswer(True, Hand.FREE))  # to nobody yet
            assert guard.newest() is None and role.answer() is None
            for setpoints in range(5):
                role.beat(Beat(Script.CONTROL, setpoints))
            newest = guard.newest()
            assert newest is not None
            assert newest[1].setpoints == 4 and math.isnan(newest[1].separation_m)
            assert guard.newest() is None
            guard.answer(GuardAnswer(True, Hand.SCRIPT))
            guard.answer(GuardAnswer(True, Hand.GUARD, "why"))
            until(lambda: role.answer() is not None)
            assert role.answer() == role.answer()
            answer = role.answer()
            assert answer is not None and answer[1] == GuardAnswer(True, Hand.GUARD, "why")
            with pytest.raises(PartError, match="cannot listen"):
                async with UdpBeatLine(bind, clock):
                    pass

    asyncio.run(main())


def test_noise_between_the_beats_changes_nothing() -> None:
    async def main() -> None:
        port, clock = free_port(), WallClock()
        bind = f"127.0.0.1:{port}"
        async with UdpBeatLine(bind, clock) as guard, UdpGuardLine(bind, clock) as role:
            role.beat(Beat(Script.LANDING, 1))
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
                stranger.sendto(b"noise", ("127.0.0.1", port))
                newest = guard.newest()
                assert newest is not None and newest[1].script is Script.LANDING
            guard.answer(GuardAnswer(False, Hand.FREE))  # to the role, not to the stranger
            until(lambda: role.answer() is not None)

    asyncio.run(main())


def test_what_another_program_says_is_counted_and_ignored() -> None:
    async def main() -> None:
        port, clock = free_port(), WallClock()
        bind = f"127.0.0.1:{port}"
        foreign = encode_beat(Beat(Script.CONTROL, 9))
        async with UdpBeatLine(bind, clock) as guard, UdpGuardLine(bind, clock) as role:
            true = KeyReader(bind).read()
            assert true is not None
            recorded = Seals().seal(true, encode_beat(Beat(Script.CONTROL, 1)))
            role.beat(Beat(Script.LANDING, 1))
            newest = guard.newest()
            assert newest is not None and guard.ignored == {}
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
                packets = (foreign, Seals().seal(bytes(32), foreign), recorded[:-1], recorded, b"")
                for packet in packets:
                    stranger.sendto(packet, ("127.0.0.1", port))
                    assert guard.newest() is None
                assert guard.ignored == {FOREIGN: len(packets)}
                stranger.setblocking(False)
                guard.answer(GuardAnswer(True, Hand.SCRIPT))  # still to the role
                until(lambda: role.answer() is not None)
                with pytest.raises(BlockingIOError):
                    stranger.recv(100)

    asyncio.run(main())


def test_who_sits_where_the_guard_was_is_not_believed() -> None:
    async def main() -> None:
        port, clock = free_port(), WallClock()
        bind = f"127.0.0.1:{port}"
        async with UdpGuardLine(bind, clock) as role:
            async with UdpBeatLine(bind, clock) as guard:
                role.beat(Beat(Script.CONTROL, 1))
                assert guard.newest() is not None
                key, path = KeyReader(bind).read(), key_path(bind)
                assert key is not None and stat.S_IMODE(path.stat().st_mode) == 0o600
            assert not path.exists()
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as impostor:
                impostor.bind(("127.0.0.1", port))
                role.beat(Beat(Script.CONTROL, 2))
                impostor.setblocking(False)
                with pytest.raises(BlockingIOError):
                    impostor.recv(100)  # nothing is said to it
                said = encode_answer(GuardAnswer(True, Hand.SCRIPT))
                impostor.sendto(said, role._socket._socket.getsockname())  # type: ignore[union-attr]
                impostor.sendto(Seals().seal(bytes(32), said), role._socket._socket.getsockname())  # type: ignore[union-attr]
                await asyncio.sleep(0)
                assert role.answer() is None
            # another run, another key, the same program
            async with UdpBeatLine(bind, clock) as again:
                role.beat(Beat(Script.CONTROL, 3))
                assert again.newest() is not None and again.ignored == {}
                again.answer(GuardAnswer(True, Hand.FREE))
                until(lambda: role.answer() is not None)

    asyncio.run(main())


def test_a_key_that_others_can_read_is_not_used() -> None:
    async def main() -> None:
        bind, clock = f"127.0.0.1:{free_port()}", WallClock()
        async with UdpBeatLine(bind, clock) as guard, UdpGuardLine(bind, clock) as role:
            key_path(bind).chmod(0o644)
            assert KeyReader(bind).read() is None
            role.beat(Beat(Script.CONTROL, 1))
            assert guard.newest() is None
        key_path(bind).unlink()
        key_path(bind).mkdir()
        try:
            with pytest.raises(PartError, match="key"):
                async with UdpBeatLine(bind, clock):
                    pass
        finally:
            key_path(bind).rmdir()

    asyncio.run(main())


def test_a_key_that_cannot_be_put_in_its_place_leaves_nothing_and_says_why(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))

    def refuse(made: Path, _place: Path, gone: bool) -> Path:
        if gone:
            made.unlink()
        raise PermissionError(13, "not yours")

    for gone in (False, True):
        monkeypatch.setattr(Path, "replace", partialmethod(refuse, gone=gone))
        with pytest.raises(PermissionError):
            make_key("127.0.0.1:9")
        assert list(tmp_path.iterdir()) == []


def test_a_guard_looks_for_its_key_ten_times_a_second_however_often_it_is_asked(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    looked: list[int] = []
    now_ns = 10**12

    class Clock:
        def now_ns(self) -> int:
            return now_ns

    def keep(_bind: str, _key: bytes) -> None:
        looked.append(now_ns)

    monkeypatch.setattr("drivers.mavlink.guard.line.keep_key", keep)
    guard = UdpBeatLine("127.0.0.1:9", Clock())
    for _ in range(100):
        assert guard.newest() is None
        now_ns += 10_000_001
    gaps = [later - earlier for earlier, later in pairwise(looked)]
    assert set(gaps) == {100_000_010}


def test_a_key_is_read_once_and_again_when_its_file_is_another_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    read: list[Path] = []

    def content(path: Path) -> bytes:
        read.append(path)
        return path.read_bytes()

    monkeypatch.setattr("drivers.mavlink.guard.seal._content", content)
    reader = KeyReader("127.0.0.1:9")
    assert reader.read() is None and read == []
    key = make_key("127.0.0.1:9")
    assert reader.read() == reader.read() == key and len(read) == 1
    other = make_key("127.0.0.1:9")
    assert reader.read() == other != key and len(read) == 2
    key_path("127.0.0.1:9").unlink()
    assert reader.read() is None


@pytest.mark.parametrize("whole_folder", [False, True])
def test_a_key_that_somebody_removes_is_there_again_before_the_role_is_taken_for_dead(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, whole_folder: bool
) -> None:
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(temporary))

    async def main() -> None:
        bind, clock = f"127.0.0.1:{free_port()}", WallClock()
        async with UdpBeatLine(bind, clock) as guard, UdpGuardLine(bind, clock) as role:
            role.beat(Beat(Script.CONTROL, 1))
            assert guard.newest() is not None
            key = key_path(bind).read_bytes()
            for each in temporary.iterdir():
                each.unlink()
            if whole_folder:
                temporary.rmdir()
            heard: list[Beat] = []

            def again() -> bool:
                role.beat(Beat(Script.CONTROL, 2))
                newest = guard.newest()
                heard.extend([] if newest is None else [newest[1]])
                return bool(heard)

            begun_s = time.monotonic()
            until(again)
            assert time.monotonic() - begun_s < GuardRules().beat_age_s
            assert key_path(bind).read_bytes() == key
            assert stat.S_IMODE(key_path(bind).stat().st_mode) == 0o600

    asyncio.run(main())


def test_without_a_guard_a_beat_hurts_nobody() -> None:
    async def main() -> None:
        async with UdpGuardLine(f"127.0.0.1:{free_port()}", WallClock()) as role:
            for _ in range(3):
                role.beat(Beat(Script.IDLE, 0))
                assert role.answer() is None

    asyncio.run(main())
