"""The truth: drones, targets, wind, what estimators get wrong, and faults."""
