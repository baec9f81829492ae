"""One drone of many, and those on the ground: what a relay and a team have in common, and a relay's base."""
