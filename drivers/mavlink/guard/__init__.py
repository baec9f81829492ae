"""The line between a role's program and its guard, and what both ends look like."""
