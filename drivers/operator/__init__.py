"""Whoever knows which object is meant: a person, or a program that does, and how a drone hears from
them.
"""
