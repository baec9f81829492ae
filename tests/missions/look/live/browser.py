"""A headless browser as a person uses one: it opens a page, touches it, and looks at it.

Chromium is driven by its own DevTools protocol. Where there is none, ``CHROMIUM`` is None, and what
needs one is skipped with that reason.
"""

from __future__ import annotations

import base64
import json
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from urllib.request import urlopen

from websockets.sync.client import ClientConnection, connect

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
CHROMIUM = next(filter(None, map(shutil.which, NAMES)), None)
WHY_NOT = f"no headless browser: none of {', '.join(NAMES)} on the PATH"
UP_S = 60.0
ANSWER_S = 60.0
FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--mute-audio", "--hide-scrollbars", "--disable-dev-shm-usage", "--remote-debugging-port=0",
)  # fmt: skip


class Tab:
    """One page, of a stated size."""

    def __init__(self, stream: ClientConnection) -> None:
        self._stream = stream
        self._asked = 0

    def size(self, width: int, height: int, ratio: float = 1.0) -> None:
        """Have the screen of a phone or a laptop, px."""
        self.do(
            "Emulation.setDeviceMetricsOverride",
            width=width, height=height, deviceScaleFactor=ratio, mobile=width < 600,
        )  # fmt: skip

    def open(self, url: str) -> None:
        self.do("Page.enable")
        self.do("Page.navigate", url=url)

    def value(self, script: str) -> Any:
        """Return what an expression of the page comes to. Raises AssertionError when it fails."""
        answer = self.do("Runtime.evaluate", expression=script, returnByValue=True)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def until(self, script: str, seconds: float = 30.0, *, drawn: bool = True) -> Any:
        """Wait until an expression is true, and return what it came to; of the live page once
        there is anything ``drawn``.
        """
        end_s = time.monotonic() + seconds
        while not (value := self.value(f"window.drawn && ({script})" if drawn else script)):
            assert time.monotonic() < end_s, f"{script} did not come true within {seconds:.0f} s"
            time.sleep(0.05)
        return value

    def tap(self, x: float, y: float) -> None:
        for kind in ("mousePressed", "mouseReleased"):
            self.do("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def tap_on(self, selector: str, dx: float | None = None, dy: float | None = None) -> None:
        """Tap the middle of an element, or so far from its upper left corner."""
        self.value(f"document.querySelector({selector!r}).scrollIntoView({{block: 'center'}})")
        x, y, w, h = self.value(
            f"(r => [r.x, r.y, r.width, r.height])(document.querySelector({selector!r}).getBoundingClientRect())"
        )
        self.tap(x + (w / 2 if dx is None else dx), y + (h / 2 if dy is None else dy))

    def picture(self) -> bytes:
        """Return what is on the screen, as PNG."""
        return base64.b64decode(self.do("Page.captureScreenshot", format="png")["data"])

    def do(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Ask the browser for something, and wait for its answer."""
        self._asked += 1
        self._stream.send(json.dumps({"id": self._asked, "method": method, "params": parameters}))
        while True:
            said = json.loads(self._stream.recv(timeout=ANSWER_S))
            if said.get("id") == self._asked:
                assert "error" not in said, said["error"]
                return said["result"]


@contextmanager
def browser() -> Generator[Tab, None, None]:
    """Start a browser with one empty tab, and end it."""
    assert CHROMIUM is not None, WHY_NOT
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        program = subprocess.Popen(
            [CHROMIUM, *FLAGS, f"--user-data-dir={profile}", "about:blank"],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            start_new_session=True,
        )  # fmt: skip
        try:
            address = _tab_of(Path(profile) / "DevToolsActivePort", program)
            with connect(address, max_size=None, proxy=None, open_timeout=UP_S) as stream:
                yield Tab(stream)
        finally:
            with suppress(ProcessLookupError):
                os.killpg(program.pid, 15)
            with suppress(subprocess.TimeoutExpired):
                program.wait(10.0)
            with suppress(ProcessLookupError):
                os.killpg(program.pid, 9)
            program.wait(10.0)


def _tab_of(told: Path, program: subprocess.Popen[bytes]) -> str:
    """Return the address at which the one tab can be driven, once there is one."""
    end_s = time.monotonic() + UP_S
    while time.monotonic() < end_s:
        assert program.poll() is None, f"the browser ended with {program.returncode}"
        with suppress(OSError, ValueError, StopIteration):
            port = int(told.read_text().split()[0])
            with urlopen(f"http://127.0.0.1:{port}/json/list", timeout=UP_S) as answer:
                tabs = json.load(answer)
            return next(tab["webSocketDebuggerUrl"] for tab in tabs if tab["type"] == "page")
        time.sleep(0.1)
    raise AssertionError(f"the browser did not start within {UP_S:.0f} s")
