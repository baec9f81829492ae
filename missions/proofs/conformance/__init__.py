"""The behaviour of an autopilot, measured the same way on each: the embedded one, PX4 and
ArduPilot.
"""
