"""What a person starts: the command line, the role programs, reports and checks."""
