"""Show, state by state, that the hand-over cannot go wrong: ``path-handoff verify``."""
