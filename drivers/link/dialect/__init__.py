"""The MAVLink 2 dialect of the hand-over: ``path.xml`` and what pymavlink's mavgen makes of it."""
