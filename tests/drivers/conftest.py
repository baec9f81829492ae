"""What the tests of the drivers share."""

from __future__ import annotations

from pathlib import Path

import pytest


@pytest.fixture
def key_file(tmp_path: Path) -> Path:
    """A key of a link, as it must be kept."""
    path = tmp_path / "pair.key"
    path.write_bytes(bytes(range(32)))
    path.chmod(0o600)
    return path
