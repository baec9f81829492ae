"""What was decided, decided again from the log (``path-handoff replay``)."""
