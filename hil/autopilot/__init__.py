"""The embedded autopilot: modes, failsafes and what its modes fly. Stepped, without I/O."""
