"""Flights in virtual time that several tests read: each is flown once in a run of tests, by
whoever asks first, in whichever worker.
"""

from __future__ import annotations

import fcntl
import os
import shutil
from pathlib import Path

import pytest

from missions.fly.handoff.flight import fly_once
from missions.ground import rig_library
from missions.look.report.records import load_facts


def flown_once(factory: pytest.TempPathFactory, seed: int, *faults: str) -> Path:
    """Return the folder of a flight of the rig ``sim``. Nothing may be written into it."""
    base = factory.getbasetemp()
    # a worker's folder is within that of all of them
    shared = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
    folder = shared / "-".join(("flown", str(seed), *faults))
    with folder.with_name(f"{folder.name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (folder.is_dir() and load_facts(folder)):
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
            fly_once(rig_library.load("sim"), seed, faults, folder, lambda _: None)
    return folder
