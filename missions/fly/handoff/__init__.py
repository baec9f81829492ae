"""``path-handoff handoff``: one leg in a simulated world, once or many times."""
