"""What stands in a drone's way, and the way around it."""
