"""Missions flown by pytest (docs/own-missions.md): ``plugin`` is loaded by pytest itself, once PATH
is installed.
"""
