"""Runs in real time: processes of programs and of the world, and what the world does."""
