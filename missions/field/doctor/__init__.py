"""``path-handoff doctor``: is everything there, and as it should be, before anything moves?"""
