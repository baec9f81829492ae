"""One hand-over: the sender's and the receiver's whole missions, and what both have in common."""
