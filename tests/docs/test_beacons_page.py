"""The page's table of packets, what the driver takes, and what the made-up beacons send."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from drivers.beacons.frames import LENGTHS, BeaconFramer
from hil.beacons.noise import BeaconConfig
from hil.beacons.system import BeaconSystem

PAGE = (Path(__file__).parent.parent.parent / "docs" / "beacons.md").read_text("utf-8")
TABLE = PAGE.split("| packet | code | the made-up beacons |")[1].split("\n\n")[0]
ROWS = [row.strip("| ").split(" | ") for row in TABLE.splitlines() if "0x" in row]
CODES = {
    tuple(int(code, 16) for code in re.findall(r"0x\w{4}", codes)): said for _, codes, said in ROWS
}


def test_every_packet_that_the_driver_takes_is_in_the_table_once() -> None:
    assert sorted(code for codes in CODES for code in codes) == sorted(code for _, code in LENGTHS)


def test_the_made_up_beacons_send_what_the_table_says() -> None:
    said = {code for codes, said in CODES.items() if "written" not in said for code in codes}
    system, framer = BeaconSystem(BeaconConfig(damage_rate=0.0), 0, {"sender": 5}), BeaconFramer()
    for turn in range(30):
        framer.feed(system.hear("sender", 0.1 * turn, np.zeros(3)).data)
    assert set(framer.counters.frames) == said
