"""One object followed from frame to frame, from the one that an operator designated."""
