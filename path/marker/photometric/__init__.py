"""Corners of a marker from a fit of its whole image."""
