"""Real autopilots: PX4's and ArduPilot's simulators as processes, and what is true in them."""
