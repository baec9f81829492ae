"""Whole missions: trajectories, beacons, the way to the viewpoint."""
