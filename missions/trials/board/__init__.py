"""Corners on a photograph of a board."""
