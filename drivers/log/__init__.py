"""The records of a drone: its log, and the one that survives a restart."""
