"""Programs killed and links cut."""
