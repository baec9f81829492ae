"""``pyrealsense2`` without system packages: its wheel needs a libusb that a minimal Debian does not
have.
"""

from __future__ import annotations

import ctypes
import importlib
from types import ModuleType

from drivers.interfaces import CameraError

LIBUSB = "libusb-1.0.so.0"


def import_realsense() -> ModuleType:
    """The ``pyrealsense2`` module. Raises CameraError saying what is missing."""
    _load_libusb()
    try:
        return importlib.import_module("pyrealsense2")
    except ImportError as error:
        raise CameraError(
            f"pyrealsense2 cannot be used: {error}",
            "it comes with PATH on x86_64, and on aarch64 with Python 3.12 only; elsewhere build librealsense",
        ) from error


def _load_libusb() -> None:
    """Into the global namespace, where the wheel looks for it: the system's, else the one of
    ``libusb-package``.
    """
    try:
        ctypes.CDLL(LIBUSB, mode=ctypes.RTLD_GLOBAL)
    except OSError:
        import libusb_package  # noqa: PLC0415 (only where the system has none)

        path = libusb_package.get_library_path()
        if path is None:
            raise CameraError(
                "libusb-1.0 is missing",
                "install libusb-1.0-0, or the Python package libusb-package",
            ) from None
        ctypes.CDLL(str(path), mode=ctypes.RTLD_GLOBAL)
