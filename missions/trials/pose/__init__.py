"""Where D2 and the target are, by single frames."""
