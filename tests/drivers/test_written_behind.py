"""What is written behind comes in order, holds nobody up, and is never lost in silence."""

from __future__ import annotations

import threading

from drivers.written_behind import WrittenBehind


def test_what_is_put_is_written_in_its_order_by_another_thread() -> None:
    written: list[tuple[bytes, bool]] = []
    me = threading.current_thread()
    behind = WrittenBehind(
        lambda data: written.append((data, threading.current_thread() is me)), 100, "test"
    )
    for k in range(5):
        assert behind.put(b"%d" % k)
    assert behind.close()
    assert written == [(b"%d" % k, False) for k in range(5)]
    assert (behind.lost, behind.waiting_bytes) == (0, 0)


def test_a_write_that_stands_still_holds_nobody_up_and_what_finds_no_room_is_counted() -> None:
    written: list[bytes] = []
    goes_on = threading.Event()

    def write(data: bytes) -> None:
        goes_on.wait(60.0)
        written.append(data)

    behind = WrittenBehind(write, 10, "test")
    assert [behind.put(b"four") for _ in range(4)] == [True, True, False, False]
    assert behind.put(b"whatever", always=True)
    assert behind.lost == 2
    assert not behind.close(0.05)
    goes_on.set()
    assert behind.close()
    assert written == [b"four", b"four", b"whatever"]


def test_what_writing_failed_with_is_kept_and_the_rest_is_not_waited_for() -> None:
    def fail(_: bytes) -> None:
        raise OSError("no disk")

    behind = WrittenBehind(fail, 10, "test")
    behind.put(b"a")
    behind.close()
    behind.put(b"b")
    assert not behind.close()
    assert str(behind.error) == "no disk"
