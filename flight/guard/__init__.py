"""A drone's safety: its own limits, and the rules of the guard in a process beside it."""
