"""What a flying program says on a stream holds it up for nobody."""

from __future__ import annotations

import os
import threading

from missions.ground.shown import Said


def test_a_terminal_that_is_held_holds_up_no_loop_and_has_all_of_it_once_it_is_let_go() -> None:
    reader, writer = os.pipe()  # takes 64 kB, as a terminal that is held takes some
    with os.fdopen(writer, "w") as stream, Said(stream) as say:
        for k in range(400):
            say(f"{k} {'x' * 1000}")
        read: list[bytes] = []

        def let_go() -> None:
            while data := os.read(reader, 1 << 16):
                read.append(data)

        terminal = threading.Thread(target=let_go)
        terminal.start()
    terminal.join(60.0)
    os.close(reader)
    said = b"".join(read).decode().splitlines()
    assert [line.split()[0] for line in said] == [str(k) for k in range(400)]


def test_a_terminal_that_is_held_for_good_is_not_waited_for() -> None:
    reader, writer = os.pipe()
    with os.fdopen(writer, "w") as stream:
        say = Said(stream)
        say.CLOSE_S = 0.05
        with say:
            for _ in range(5000):
                say("x" * 1000)
        assert say.lost > 0
        os.read(reader, 1)
        os.close(reader)


def test_a_reader_that_is_gone_is_nobody() -> None:
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "w") as stream, Said(stream) as say:
        for _ in range(3):
            say("to nobody")
