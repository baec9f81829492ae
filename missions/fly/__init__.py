"""What flies: one drone's leg, a hand-over, a relay, a team, a mission of your own, and the guard
beside it.
"""
