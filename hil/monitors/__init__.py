"""Safety monitors: they see the truth and every decision, and count what must never happen."""
