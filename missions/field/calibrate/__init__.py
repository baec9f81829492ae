"""``path-handoff calibrate``: a camera, where it sits relative to the marker, and boards to
print.
"""
