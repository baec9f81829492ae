"""Ultrasonic beacons: Marvelmind over serial ports, and records of them."""
