"""The options of the commands. The command line is generated from these, and so is its help."""
