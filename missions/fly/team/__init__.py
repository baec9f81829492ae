"""``path-handoff team``: many drones keep many targets observed."""
