"""The target as D1 sees it: where it is, how large, and what stands beside it."""
