"""The bodies that can be tracked, and what is printed on markers: their shapes and colours."""
