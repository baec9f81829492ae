"""The seam between a mission and the harness behind it: what is asked for, and what it answers."""
