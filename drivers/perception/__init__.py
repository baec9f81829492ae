"""Observations from frames: detections, markers and depth of one image, and the instants they
belong to.
"""
