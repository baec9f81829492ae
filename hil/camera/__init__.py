"""Simulated cameras: when they take a picture, how they make it, and how it reaches its driver."""
