"""Calibration of a camera from views of a flat board, and of where a camera sits relative to the
marker.
"""
