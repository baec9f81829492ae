"""Rigs: TOML files that name the parts of the drones, read, checked and made into parts."""
