"""How soon a hand-over is agreed, and whether it is ever wrong."""
