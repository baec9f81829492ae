"""Twenty minutes in real time."""
