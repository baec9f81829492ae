"""Hand-overs among obstacles."""
