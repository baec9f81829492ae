"""Perception of level ``sim``: observations straight from the geometry, with measured noise."""
