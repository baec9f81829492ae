"""What a drone does in the air, written on the driver Protocols only."""
