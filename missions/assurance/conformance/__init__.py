"""How an autopilot behaves, measured the same way on each: the embedded one, PX4 and ArduPilot."""
