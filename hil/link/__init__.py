"""The link between simulated drones, with its faults."""
