"""The plan of a leg: from what was measured to everything that is flown, with what limits it and
what it predicts.
"""
