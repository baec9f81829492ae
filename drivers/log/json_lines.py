"""The words of one process to another: lines of JSON."""

from __future__ import annotations

import json
import os
from typing import Any


class JsonLines:
    """Lines of JSON that come in on a file, each as soon as it is whole.

    Not ``sys.stdin.readline``: of two lines that come at once it would keep the second to itself,
    and nothing more comes in to be told of.
    """

    def __init__(self, file: int) -> None:
        self._file = file
        self._begun = b""

    def read(self) -> list[dict[str, Any]] | None:
        """Return what has come in since, when there is something to read; None at the end."""
        data = os.read(self._file, 65536)
        if not data:
            return None
        *lines, self._begun = (self._begun + data).split(b"\n")
        return [json.loads(line) for line in lines]
