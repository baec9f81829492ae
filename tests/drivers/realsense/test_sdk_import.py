"""pyrealsense2 is imported with the system's libusb or without."""

from __future__ import annotations

import ctypes
import subprocess
import sys

import pytest

from drivers.interfaces import CameraError
from drivers.realsense import sdk_import as realsense_import

WITHOUT_SYSTEM_LIBRARY = f"""
import ctypes
load = ctypes.CDLL
def without_system_library(name, *args, **kwargs):
    if name == {realsense_import.LIBUSB!r}:
        raise OSError(name)
    return load(name, *args, **kwargs)
ctypes.CDLL = without_system_library
from drivers.realsense.sdk_import import import_realsense
print(import_realsense().context.__name__)
"""


def test_it_works_without_the_systems_libusb() -> None:
    """In a process of its own: a library once loaded stays."""
    ran = subprocess.run(
        [sys.executable, "-c", WITHOUT_SYSTEM_LIBRARY], capture_output=True, text=True, check=False
    )
    assert ran.stdout == "context\n", ran.stderr


def test_what_is_missing_is_named_with_its_fix(monkeypatch: pytest.MonkeyPatch) -> None:
    def load(name: str, mode: int) -> None: ...

    monkeypatch.setattr(ctypes, "CDLL", load)
    monkeypatch.setitem(sys.modules, "pyrealsense2", None)
    with pytest.raises(CameraError, match="cannot be used") as caught:
        realsense_import.import_realsense()
    assert "aarch64" in caught.value.remedy
