"""Many seeded runs of the hand-over under faults: of its machines with real messages, and of both
whole programs.
"""
