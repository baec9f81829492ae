"""The lines of JSON from one process to another."""

from __future__ import annotations

import os

from drivers.log.json_lines import JsonLines


def test_commands_that_come_at_once_are_all_there_and_half_a_line_waits_for_the_rest() -> None:
    reading, writing = os.pipe()
    commands = JsonLines(reading)
    os.write(
        writing,
        b'{"fault": "link_loss", "value": 0.1}\n{"fault": "link_jitter", "value": 0.05}\n{"fin',
    )
    assert commands.read() == [
        {"fault": "link_loss", "value": 0.1},
        {"fault": "link_jitter", "value": 0.05},
    ]
    os.write(writing, b'ish": 45.0}\n')
    assert commands.read() == [{"finish": 45.0}]
    os.close(writing)
    assert commands.read() is None
    os.close(reading)
