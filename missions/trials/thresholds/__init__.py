"""The sweep that chose the thresholds."""
