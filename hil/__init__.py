"""Hardware-in-the-loop harness: substitutes for what the drivers talk to. Nothing imports it; a rig
names it.
"""
