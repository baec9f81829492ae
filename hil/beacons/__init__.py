"""Ultrasonic beacons of a simulated world, and the bytes that they send."""
