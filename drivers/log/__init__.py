"""What a drone writes down: its log, and the record that survives a restart."""
