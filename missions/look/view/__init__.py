"""Runs and flights as a person looks at them: in Rerun, and the layout for Foxglove and
Lichtblick.
"""
