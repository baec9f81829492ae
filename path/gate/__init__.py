"""The gate before a commit: which pairs agree, and when enough of them have."""
