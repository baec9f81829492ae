"""The rigs that come with PATH, as files."""

from pathlib import Path

FOLDER = Path(__file__).parent
