"""A Tello on the wire, for an unmodified djitellopy."""
