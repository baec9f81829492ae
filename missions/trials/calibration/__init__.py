"""How good calibrations of rendered boards are."""
