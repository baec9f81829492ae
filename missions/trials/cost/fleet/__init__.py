"""The cost of a team by its size."""
