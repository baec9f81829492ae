"""Both drones and the target moving."""
