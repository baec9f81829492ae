"""Whole attempts: commits, time-outs, and times."""
