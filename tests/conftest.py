"""What all tests share, and how property tests run everywhere: the same examples each time, and no limit of wall time.

Machines are noisy. ``pytest --hypothesis-profile=explore`` looks for new examples.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import settings

settings.register_profile("steady", derandomize=True, deadline=None)
settings.register_profile("explore", max_examples=1000, deadline=None)
settings.load_profile("steady")


@pytest.fixture
def key_file(tmp_path: Path) -> Path:
    """A key of a link, as it must be kept."""
    path = tmp_path / "pair.key"
    path.write_bytes(bytes(range(32)))
    path.chmod(0o600)
    return path
