"""Decisions made again from the log (``path-handoff replay``)."""
