"""Accuracy in flight against ultrasonic beacons."""
