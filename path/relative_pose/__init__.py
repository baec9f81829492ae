"""The marker's pose relative to D2's camera, filtered over time."""
