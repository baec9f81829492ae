"""The behaviour of a drone in the air, written on the driver Protocols only."""
