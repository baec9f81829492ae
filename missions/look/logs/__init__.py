"""Conversions of logs for other programs: one log on one clock, trajectories, tables."""
