"""Photographs of boards: corners and poses against the whole board."""
