"""``path-handoff plan``: what follows from what a rig measured."""
