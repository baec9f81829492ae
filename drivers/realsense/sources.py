"""Sources of a RealSense device: this computer's USB, a recording, or what a rig names by a
factory.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol

from drivers.interfaces import CameraError
from drivers.realsense.sdk import connected, load_recording, serial_of


class DeviceSource(Protocol):
    """Gives the ``pyrealsense2.device`` of one camera. All calls come from one thread.

    ``live``: its wall-clock stamps are of now. ``returns``: a device that fell silent may be there
    again later.
    """

    @property
    def name(self) -> str: ...

    @property
    def live(self) -> bool: ...

    @property
    def returns(self) -> bool: ...

    def open(self) -> Any:
        """A device nobody else uses. Bounded in time. Raises CameraError with what was found
        instead.
        """
        ...

    def missing(self) -> CameraError | None:
        """Return why it gives no frames and what to do, as far as that is known; None when it is
        there.
        """
        ...

    def close(self) -> None:
        """Close the source, after the streams were stopped."""
        ...


class UsbSource:
    """The connected camera with a serial number; without one, the only one connected."""

    live = True
    returns = True

    def __init__(self, serial: str, query: Callable[[], Sequence[Any]] = connected) -> None:
        self._serial = serial
        self._query = query

    @property
    def serial(self) -> str:
        """The serial number of the camera, once it was found; "" before."""
        return self._serial

    @property
    def name(self) -> str:
        return f"RealSense {self._serial}" if self._serial else "RealSense"

    def open(self) -> Any:
        devices = list(self._query())
        serials = [serial_of(device) for device in devices]
        listed = ", ".join(sorted(serials))
        if not devices:
            raise CameraError(
                "no RealSense camera is connected",
                "plug it into a USB 3 port; on Linux, install librealsense's udev rules, or it shows to root only",
            )
        if not self._serial and len(devices) > 1:
            raise CameraError(
                f"{len(devices)} RealSense cameras are connected: {listed}",
                "set `serial` to one of them",
            )
        matching = [
            device
            for device, serial in zip(devices, serials, strict=True)
            if self._serial in ("", serial)
        ]
        if len(matching) != 1:
            what = "no" if not matching else f"{len(matching)}"
            raise CameraError(
                f"{what} RealSense cameras with serial {self._serial} are connected; there are: {listed}",
                "set `serial` to one of them, or plug the right camera in",
            )
        self._serial = serial_of(matching[0])  # the same again after it was unplugged
        return matching[0]

    def missing(self) -> CameraError | None:
        if self._serial in [serial_of(device) for device in self._query()]:
            return None
        return CameraError(
            "it is no longer connected", "see whether its cable holds, and plug it in again"
        )

    def close(self) -> None:
        pass


class RecordingSource:
    """A file that ``record`` or librealsense's viewer wrote, played at the rate it was recorded at,
    once.
    """

    live = False
    returns = False

    def __init__(self, file: Path) -> None:
        self._file = file

    @property
    def name(self) -> str:
        return f"recording {self._file.name}"

    def open(self) -> Any:
        return load_recording(self._file)

    def missing(self) -> CameraError:
        return CameraError("it has ended", "play a longer one, or play it again")

    def close(self) -> None:
        pass
