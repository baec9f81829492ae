"""What keeps a drone safe: its own limits, and the rules of the guard in a process beside it."""
