"""``path-handoff relay``: one target, handed from drone to drone."""
