"""``path-handoff relay`` and ``team``: what many drones fly, whether for one target or many."""
