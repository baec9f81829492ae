"""Detectors that miss and invent, and what both gates make of it."""
