"""What PATH takes: time, bytes, memory, and what it bears."""
