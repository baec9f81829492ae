"""Rigid transforms and rotations."""
