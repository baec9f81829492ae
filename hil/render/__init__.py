"""Synthetic cameras: colour and registered depth of the simulated world, metrically exact up to the
sensor's noise.
"""
