"""From bad positions, in wind."""
