"""Proof that nothing unsafe can happen: the explorer, campaigns of faults, and conformance of the
autopilots.
"""
