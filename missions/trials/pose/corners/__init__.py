"""Corners of the marker by every method, on rendered frames."""
