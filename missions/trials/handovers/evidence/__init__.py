"""The evidence gate and its bound."""
