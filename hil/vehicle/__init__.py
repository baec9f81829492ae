"""The embedded autopilot, its MAVLink, and the processes of real autopilots."""
