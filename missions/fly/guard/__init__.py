"""``path-handoff guard``: holds and lands a drone whose script does not."""
