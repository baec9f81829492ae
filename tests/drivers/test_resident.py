"""Pages of a file that nobody needs are given back, and what was written over them is not."""

from __future__ import annotations

import ctypes
import mmap
import os
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from drivers.resident import MAPS, give_back, mappings

PAGES = 64
pytestmark = pytest.mark.skipif(
    sys.platform != "linux", reason="the kernel's own account of memory"
)


def resident_kb(file: Path) -> int:
    return sum(
        each.resident_kb for each in mappings(MAPS.read_text("utf-8")) if each.file == str(file)
    )


def test_a_files_pages_are_given_back_and_are_there_again(tmp_path: Path) -> None:
    file = tmp_path / "library.so"
    file.write_bytes(bytes(range(256)) * 16 * PAGES)
    with (
        file.open("rb") as opened,
        mmap.mmap(opened.fileno(), 0, mmap.MAP_PRIVATE, mmap.PROT_READ) as mapped,
    ):
        assert len(bytes(mapped)) == 4096 * PAGES
        assert resident_kb(file) == 4 * PAGES
        assert give_back("library.so") == 4 * PAGES
        assert resident_kb(file) == 0
        assert mapped[4096 * 7 + 5] == 5


def cached_pages(mapped: mmap.mmap) -> int:
    """How many pages of a file the kernel has in memory."""
    which = (ctypes.c_ubyte * PAGES)()
    begin = np.frombuffer(mapped, np.uint8).ctypes.data
    assert ctypes.CDLL(None).mincore(ctypes.c_void_p(begin), 4096 * PAGES, which) == 0
    return sum(page & 1 for page in which)


def test_pages_that_nobody_has_touched_yet_are_read_before_they_are_needed(tmp_path: Path) -> None:
    """On the ground, so that no loop stands for a disk in flight."""
    file = tmp_path / "library.so"
    file.write_bytes(bytes(range(256)) * 16 * PAGES)
    with (
        file.open("rb") as opened,
        mmap.mmap(opened.fileno(), 0, mmap.MAP_PRIVATE, mmap.PROT_READ) as mapped,
    ):
        os.fsync(opened.fileno())
        os.posix_fadvise(opened.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
        if cached_pages(mapped):
            pytest.skip("this file system is in memory")
        give_back("library.so")
        end_s = time.monotonic() + 60.0
        while cached_pages(mapped) < PAGES and time.monotonic() < end_s:
            time.sleep(0.01)
        assert cached_pages(mapped) == PAGES
        assert resident_kb(file) == 0  # in the kernel's cache, not in this program's memory


def test_what_was_written_over_stays(tmp_path: Path) -> None:
    file = tmp_path / "library.so"
    file.write_bytes(bytes(4096 * PAGES))
    rights = mmap.PROT_READ | mmap.PROT_WRITE
    with (
        file.open("rb") as opened,
        mmap.mmap(opened.fileno(), 0, mmap.MAP_PRIVATE, rights) as mapped,
    ):
        mapped[:] = b"x" * 4096 * PAGES
        assert give_back("library.so") == 0
        assert mapped[4096] == ord("x")


def test_a_library_that_is_not_there_gives_nothing() -> None:
    assert give_back("/no/such/library") == 0
